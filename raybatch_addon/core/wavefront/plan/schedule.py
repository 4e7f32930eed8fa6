"""The schedule of a render: by which loop its paths go on (pure policy, without a device)."""

from __future__ import annotations

from ...film.layout import COST_PASSES
from ...scene.features import SceneFeatures
from ...settings.settings import RenderSettings
from .plan import Method


def why_not_streaming(settings: RenderSettings, features: SceneFeatures, method: Method) -> str:
    """Why a render takes the schedule WAVEFRONT, though the setting `schedule` is STREAMING; empty where it does not.

    `method`: how its rays meet the scene.
    """
    if method is Method.PAGED:
        remedy = "raise geometry_budget" if settings.geometry_budget else "render a smaller scene"
        return f"its geometry does not fit in memory, and the host brings pages of it; {remedy}"
    if method is Method.REFERENCE:
        return "batching is REFERENCE, and Warp's own tree is traced in lists; set batching to AUTO, ON or OFF"
    if features.fetch_program:
        remedy = "raise texture_budget" if settings.texture_budget else "use smaller images"
        return f"its images do not fit in memory, and the host brings tiles of them; {remedy}"
    if features.catchers:
        return "the scene has shadow catchers, whose paths begin again between turns; make them usual surfaces"
    if settings.is_on("counters") or not set(COST_PASSES).isdisjoint(features.passes):
        return "steps are counted in lists of rays; set counters to OFF, and leave out passes that show cost"
    return ""


def with_schedule(
    settings: RenderSettings, features: SceneFeatures, method: Method
) -> tuple[RenderSettings, list[str]]:
    """`settings` of a render with the schedule that it takes, and a warning where it is not the one that is asked for.
    The kernel of STREAMING is always specialised on the scene.
    """
    if settings.schedule != "STREAMING":
        return settings, []
    if why := why_not_streaming(settings, features, method):
        warnings = [f"schedule is WAVEFRONT, not STREAMING: {why}"]
        if settings.treelet_tier_bytes:  # the plan, and its tree, are made for STREAMING
            warnings.append("treelet_tier_bytes is not used with STREAMING; set schedule to WAVEFRONT for it")
        return settings.replace(schedule="WAVEFRONT", treelet_tier_bytes=0), warnings
    return settings.replace(kernel_tier="SPECIALISED"), []
