"""The passes of a film by name: how many channels each has, and what a render records for it."""

from __future__ import annotations

# Passes that show what a pixel's paths cost, as the mean over its samples
COST_PASSES = ("Rays", "Node Steps", "Triangle Tests", "Treelet Visits", "Times Queued")
# The pass that shows how many samples each pixel has
SAMPLE_COUNT = "Sample Count"
# Passes that the first sample alone decides: an average of them means nothing
FIRST_SAMPLE_PASSES = ("Depth", "Position", "Object Index", "Material Index")
# What Blender writes as the depth of nothing [m]
DEPTH_OF_NOTHING = 1e10
# Kinds of surfaces' light, by the closures that scatter it where a path scatters first
COMPONENTS = ("Diffuse", "Glossy", "Transmission")
COLOR_PASSES = tuple(f"{component} Color" for component in COMPONENTS)
# Light over one scattering and over more; in the film's pass it is divided by the colour of its component
DIRECT_PASSES = tuple(f"{component} Direct" for component in COMPONENTS)
INDIRECT_PASSES = tuple(f"{component} Indirect" for component in COMPONENTS)
# Light that reaches the camera without scattering: of surfaces and lights, and of the world
SEEN_PASSES = ("Emission", "Environment")
# How much of the half-space about a surface is open
OCCLUSION_PASS = "Ambient Occlusion"
# Light that volumes scatter first, over one scattering and over more
VOLUME_PASSES = ("Volume Direct", "Volume Indirect")
# Motion in the picture, and what its sum is divided by: the samples that saw a surface or the background
VECTOR, VECTOR_WEIGHT = "Vector", "Vector Weight"
# What shadow catchers get of light, over what they would get if nothing else were there; and how dark their shadows lie
# on what is behind, where Combined has them (`film/caught.py`)
CATCHER_PASS, CATCHER_SHADOWS = "Shadow Catcher", "Catcher Shadows"
# Passes that guide a denoiser (`wavefront/passes/guides.py`)
GUIDE_PASSES = ("Denoising Albedo", "Denoising Normal", "Denoising Depth")
# Channels of passes whose samples are summed beside those of Combined and Normal
SUMMED_PASSES: dict[str, int] = {
    "Mist": 1,
    "UV": 3,
    VECTOR: 4,
    **dict.fromkeys((*DIRECT_PASSES, *INDIRECT_PASSES, *COLOR_PASSES, *SEEN_PASSES, *VOLUME_PASSES, OCCLUSION_PASS), 3),
    **dict(zip(GUIDE_PASSES, (3, 3, 1))),
}
# What is summed for the passes of shadow catchers: light of paths that met one first, and of their copies, which see
# catchers alone; by how much Combined is opaque by catchers alone; the world behind them, for `CATCHER_SHADOWS`
CATCHER_SUMS = {"Caught Light": 3, "Catcher Light": 3, "Catcher Alpha": 1, "Caught World": 3}
CAUGHT_LIGHT, CATCHER_LIGHT, CATCHER_ALPHA, CAUGHT_WORLD = CATCHER_SUMS
# Kinds of identities that mattes are made by. Each has passes of two levels, which are numbered behind its name
MATTE_KINDS = ("CryptoObject", "CryptoMaterial", "CryptoAsset")
MATTE_PASSES = tuple(f"{kind}{i:02}" for kind in MATTE_KINDS for i in range(8))
# Channels of every pass
PASSES: dict[str, int] = {
    "Combined": 4,
    "Depth": 1,
    "Position": 3,
    "Normal": 3,
    "Object Index": 1,
    "Material Index": 1,
    **SUMMED_PASSES,
    **dict.fromkeys(MATTE_PASSES, 4),
    **dict.fromkeys((*COST_PASSES, SAMPLE_COUNT, CATCHER_SHADOWS), 1),
    CATCHER_PASS: 3,
}
# Beginnings of the names of passes that materials write by themselves (AOVs): of a colour, of a number
AOV_COLOR, AOV_VALUE = "AOV color ", "AOV value "
# Beginning of the names of passes of the light of a group of emitters, as Cycles has it
LIGHT_GROUP = "Combined_"
# Passes whose values are known at the first surface of a path
_RECORDED = frozenset(("Mist", "UV", VECTOR, "Object Index", "Material Index", *COLOR_PASSES, *MATTE_PASSES))
# Letters of channels that are no colour; those of other passes follow from their number
_LETTERS = {
    **dict.fromkeys(("Depth", "Mist", "Denoising Depth"), "Z"),
    **dict.fromkeys(("Position", "Normal", "Denoising Normal"), "XYZ"),
    VECTOR: "XYZW",
    "UV": "UVA",
}
# Passes that light is divided among
_SPLIT = frozenset((*DIRECT_PASSES, *INDIRECT_PASSES, *SEEN_PASSES, *VOLUME_PASSES))


def channels_of(name: str) -> int:
    """Channels of the pass `name`; raises `KeyError` where there is no such pass."""
    if name.startswith(AOV_COLOR):
        return 4
    if name.startswith(LIGHT_GROUP):
        return 3
    if name == VECTOR_WEIGHT:
        return 1
    if name in CATCHER_SUMS:
        return CATCHER_SUMS[name]
    return 1 if name.startswith(AOV_VALUE) else PASSES[name]


def letters_of(name: str) -> str:
    """What files call the channels of the pass `name`, a letter each; raises `KeyError` where there is no such pass."""
    if name in _LETTERS:
        return _LETTERS[name]
    if name in MATTE_PASSES:
        return "rgba"  # lower case, by which files know that they must not be compressed with loss
    return {1: "X", 3: "RGB", 4: "RGBA"}[channels_of(name)]


def is_pass(name: str) -> bool:
    """Whether a film can have a pass of this name."""
    return name in PASSES or name.startswith((AOV_COLOR, AOV_VALUE, LIGHT_GROUP))


def aov_passes(passes: tuple[str, ...]) -> tuple[str, ...]:
    """The names of `passes` that materials write; their places are the numbers that programs know them by."""
    return tuple(name for name in passes if name.startswith((AOV_COLOR, AOV_VALUE)))


def light_group_passes(passes: tuple[str, ...]) -> tuple[str, ...]:
    """The names of `passes` that show the light of a group of emitters."""
    return tuple(name for name in passes if name.startswith(LIGHT_GROUP))


def matte_kinds(pass_names: tuple[str, ...]) -> tuple[str, ...]:
    """The kinds of `MATTE_KINDS` that some of `pass_names` show."""
    return tuple(kind for kind in MATTE_KINDS if any(name.startswith(kind) for name in pass_names))


def summed_passes(passes: tuple[str, ...]) -> tuple[str, ...]:
    """What is summed for `passes` beside Combined and Normal, in a fixed order: those of them that are means, and the
    colours that light is divided by.
    """
    wanted = set(passes)
    for light in (DIRECT_PASSES, INDIRECT_PASSES):
        wanted.update(color for name, color in zip(light, COLOR_PASSES) if name in passes)
    weights = (VECTOR_WEIGHT,) if VECTOR in wanted else ()
    caught: tuple[str, ...] = ()
    if shows_catchers(passes):
        caught = tuple(name for name in CATCHER_SUMS if name != CAUGHT_WORLD or CATCHER_SHADOWS in wanted)
    return (
        *(name for name in SUMMED_PASSES if name in wanted),
        *weights,
        *caught,
        *light_group_passes(passes),
        *aov_passes(passes),
    )


def shows_colors(passes: tuple[str, ...]) -> bool:
    """Whether the colours of surfaces are summed for any of `passes`."""
    return not set(COLOR_PASSES).isdisjoint(summed_passes(passes))


def records_surfaces(passes: tuple[str, ...]) -> bool:
    """Whether the first surfaces of paths are recorded for any of `passes`."""
    return bool(aov_passes(passes)) or not _RECORDED.isdisjoint((*passes, *summed_passes(passes)))


def shows_catchers(passes: tuple[str, ...]) -> bool:
    """Whether some of `passes` show what shadow catchers catch; where none does, catchers are objects as any other."""
    return CATCHER_PASS in passes or CATCHER_SHADOWS in passes


def guides_denoising(passes: tuple[str, ...]) -> bool:
    """Whether some of `passes` guide a denoiser."""
    return not set(GUIDE_PASSES).isdisjoint(passes)


def splits_light(passes: tuple[str, ...]) -> bool:
    """Whether light is divided among some of `passes`."""
    return not _SPLIT.isdisjoint(passes)
