"""Every kernel of the core is compiled without contraction, fast math or adjoints."""

import warp as wp

from raybatch_addon.core.device.kernel import MODULE_OPTIONS, OUT_OF_LINE_OPTIONS, is_general
from raybatch_addon.core.settings.settings import RenderSettings
from tests.support import scenes


def test_every_loaded_module_has_the_options(session):
    session.render(scenes.mixed(), RenderSettings(sample_count=1))
    seen = 0
    for name, module in wp._src.context.user_modules.items():
        kernels = [k for k in module.kernels.values() if k.func.__module__.startswith("raybatch_addon.core")]
        for kernel in kernels:
            seen += 1
            options = {key: module.options[key] for key in MODULE_OPTIONS}
            assert options in (
                [OUT_OF_LINE_OPTIONS] if is_general(module) else [MODULE_OPTIONS, OUT_OF_LINE_OPTIONS]
            ), name
            assert kernel.options.get("enable_backward") is False, name
    assert seen >= 10
