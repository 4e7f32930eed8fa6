"""Settings that decide what a film estimates: they change the picture."""

from __future__ import annotations

from dataclasses import dataclass

from .info import INT_MAX, setting

# Largest limit of bounces of one kind, which counts as none: Cycles' own range
KIND_BOUNCES_MOST = 1024


@dataclass(frozen=True, kw_only=True)
class EstimatorSettings:
    """How many paths are traced, how far light is followed, and how samples become pixels."""

    sample_count: int = setting(
        128,
        "Samples",
        "Paths traced through every pixel",
        group="SAMPLING",
        unit="samples per pixel",
        minimum=1,
        maximum=INT_MAX,
    )
    adaptive_sampling: str = setting(
        "OFF",
        "Adaptive Sampling",
        "End the sampling of pixels whose neighbourhood shows little noise, so that the others get the time",
        group="SAMPLING",
        choices=(
            ("OFF", "Off", "Every pixel gets all samples"),
            (
                "ON",
                "On",
                "A pixel gets samples until the noise around it is below Max Noise, and no more than Samples. "
                "Samples come in two halves, which differ by the noise: it implies Error Estimate",
            ),
        ),
    )
    noise_threshold: float = setting(
        0.01,
        "Max Noise",
        "Noise below which a pixel gets no more samples, relative to its brightness: the standard deviation, summed "
        "over channels, divided by the root of their sum (above 1 by the sum itself). 0 ends no pixel",
        group="SAMPLING",
        unit="relative",
        minimum=0.0,
        maximum=1.0,
    )
    adaptive_samples_min: int = setting(
        0,
        "Min Samples",
        "Samples that every pixel gets before the first look at its noise; {rest} chooses by Max Noise",
        group="SAMPLING",
        unit="samples per pixel",
        minimum=0,
        maximum=INT_MAX,
        auto=0,
        start=16,
    )
    time_limit: float = setting(
        0.0,
        "Time Limit",
        "A render ends when no more samples of every pixel are expected to fit in this time, counted without build and "
        "compilation; {rest} sets no limit. One sample is always rendered",
        group="SAMPLING",
        unit="s",
        minimum=0.0,
        maximum=1e9,
        off=0.0,
        start=60.0,
    )
    error_estimate: str = setting(
        "OFF",
        "Error Estimate",
        "Estimate how far the picture is from its limit at infinitely many samples, without a reference",
        group="ERROR",
        choices=(
            ("OFF", "Off", "All samples have the same seed"),
            (
                "ON",
                "On",
                "Every other sample has another seed, and either half a film of its own: how far they differ gives the "
                "error of both together",
            ),
        ),
    )
    error_target: float = setting(
        0.0,
        "Stop at Error",
        "A render ends when its estimated error is at most this: the mean over pixels and channels of the "
        "squared error over the squared value (relMSE). It implies Error Estimate; {rest} renders all samples",
        group="ERROR",
        unit="relMSE",
        minimum=0.0,
        maximum=1e9,
        off=0.0,
        start=0.001,
    )
    seed: int = setting(
        0,
        "Seed",
        "Chooses another set of random numbers, and so another pattern of noise",
        group="ADVANCED",
        minimum=0,
        maximum=INT_MAX,
    )
    sample_sequence: str = setting(
        "SOBOL",
        "Sequence",
        "How the random numbers of a pixel are spread",
        group="ADVANCED",
        choices=(
            (
                "SOBOL",
                "Sobol",
                "Owen-scrambled Sobol points, of low discrepancy: less noise at the same sample count (Burley 2020)",
            ),
            (
                "BLUE_NOISE",
                "Blue Noise",
                "Points that neighbouring pixels share out among them: as little noise in a pixel as Sobol points, and "
                "at few samples it is fine-grained, so that it vanishes when looked at from afar or denoised. Its "
                "first render waits until kernels are compiled, for a minute or so",
            ),
            (
                "INDEPENDENT",
                "Independent",
                "Independent Philox numbers: error statistics are textbook Monte Carlo. Its first render waits until "
                "kernels are compiled, for a minute or so",
            ),
        ),
    )
    nee: str = setting(
        "ON",
        "Light Sampling",
        "Next-event estimation: aim a shadow ray at a light from every surface",
        group="ADVANCED",
        choices=(
            ("ON", "On", "Lights are sampled directly, combined with BSDF sampling by multiple importance sampling"),
            ("OFF", "Off", "Light is found by BSDF sampling alone; lights without size then give no light"),
            ("HALF", "Half", "On in the left half of the frame, off in the right half, for comparing"),
        ),
    )
    mis: str = setting(
        "ON",
        "Use MIS",
        "Multiple importance sampling: what light sampling and BSDF sampling can both find is weighted by how likely "
        "each finds it",
        group="ADVANCED",
        choices=(
            (
                "ON",
                "On",
                "Weights of the power heuristic (Veach 1997): low noise whichever of the two is the better one",
            ),
            (
                "OFF",
                "Off",
                "Light sampling alone finds what it can find: a control, noisy near lights and on shiny surfaces. "
                "Unused without light sampling",
            ),
        ),
    )

    bounce_max: int = setting(
        8,
        "All Bounces",
        "Bounces of indirect light; 0 renders direct light only",
        group="BOUNCES",
        unit="bounces",
        minimum=0,
        maximum=100_000,
    )
    diffuse_bounce_max: int = setting(
        KIND_BOUNCES_MOST,
        "Diffuse",
        "Most bounces of a path that are diffuse reflections; {rest} sets no limit but All Bounces",
        group="BOUNCES",
        unit="bounces",
        minimum=0,
        maximum=KIND_BOUNCES_MOST,
        off=KIND_BOUNCES_MOST,
        start=4,
    )
    glossy_bounce_max: int = setting(
        KIND_BOUNCES_MOST,
        "Glossy",
        "Most bounces of a path that are reflections by facets, sharp or not; {rest} sets no limit but All Bounces",
        group="BOUNCES",
        unit="bounces",
        minimum=0,
        maximum=KIND_BOUNCES_MOST,
        off=KIND_BOUNCES_MOST,
        start=4,
    )
    transmission_bounce_max: int = setting(
        KIND_BOUNCES_MOST,
        "Transmission",
        "Most bounces of a path that are refractions, or pass light to the other side in another way; "
        "{rest} sets no limit but All Bounces",
        group="BOUNCES",
        unit="bounces",
        minimum=0,
        maximum=KIND_BOUNCES_MOST,
        off=KIND_BOUNCES_MOST,
        start=12,
    )
    transparent_bounce_max: int = setting(
        8,
        "Transparent",
        "Transparent surfaces that a ray passes before it is taken as blocked",
        group="BOUNCES",
        unit="surfaces",
        minimum=0,
        maximum=1024,
    )
    volume_bounce_max: int = setting(
        1024,
        "Volume",
        "Bounces of indirect light within volumes, which count as bounces too; 0: light scatters there once at most",
        group="BOUNCES",
        unit="bounces",
        minimum=0,
        maximum=100_000,
    )
    roulette_bounce: int = setting(
        2,
        "From Bounce",
        "Bounce from which Russian roulette may end a path that carries little light (unbiased)",
        group="ROULETTE",
        unit="bounces",
        minimum=0,
        maximum=100_000,
    )
    roulette_throughput: float = setting(
        0.5,
        "Throughput",
        "Throughput, the share of light that a path carries, below which Russian roulette may end it: the path goes on "
        "with a probability of its throughput over this",
        group="ROULETTE",
        minimum=1e-6,
        maximum=1.0,
    )
    clamp_direct: float = setting(
        0.0,
        "Direct Light",
        "Largest radiance of one light seen directly or at the first bounce; {rest} does not clamp. Clamping loses "
        "light",
        group="CLAMPING",
        unit="W/(m² sr)",
        minimum=0.0,
        maximum=1e30,
        off=0.0,
        start=10.0,
    )
    clamp_indirect: float = setting(
        0.0,
        "Indirect Light",
        "Largest radiance of one light found after the first bounce; {rest} does not clamp. Clamping loses light",
        group="CLAMPING",
        unit="W/(m² sr)",
        minimum=0.0,
        maximum=1e30,
        off=0.0,
        start=10.0,
    )

    filter_glossy: float = setting(
        0.0,
        "Filter Glossy",
        "Roughens surfaces for paths that came by unlikely directions, so that caustics are less noisy, and blurred: "
        "the larger the more. 0 leaves all as they are",
        group="CAUSTICS",
        minimum=0.0,
        maximum=100.0,
    )
    caustics_reflective: str = setting(
        "ON",
        "Reflective",
        "Light that glossy surfaces throw on diffuse ones: noisy where the source is small",
        group="CAUSTICS",
        choices=(
            ("ON", "On", "All of it is rendered"),
            (
                "OFF",
                "Off",
                "What a diffuse ray meets reflects no light sharply; glass still lets it through. It is darker",
            ),
        ),
    )
    caustics_refractive: str = setting(
        "ON",
        "Refractive",
        "Light that comes through glass to diffuse surfaces: noisy where the source is small",
        group="CAUSTICS",
        choices=(
            ("ON", "On", "All of it is rendered"),
            ("OFF", "Off", "Glass that a diffuse ray meets lets no light through, and still reflects it. It is darker"),
        ),
    )

    texture_filter: str = setting(
        "OFF",
        "Texture Filter",
        "How images of materials are looked up where a path sees many texels at once",
        group="TEXTURES",
        choices=(
            ("OFF", "Off", "Every look-up reads the image itself: without error, and noisy where texels are small"),
            (
                "FOOTPRINT",
                "Footprint",
                "Look-ups read a smaller level of the image, whose texels are as large as what the path sees of the "
                "surface: less noise from fine textures far away and in blurred reflections, and a little blur. "
                "Levels take a third more memory. Shadows and light that is aimed at read the image itself",
            ),
        ),
    )
    texture_filter_width: float = setting(
        0.25,
        "Filter Width",
        "Width of the area that a look-up is filtered over, in widths of what the path sees; smaller is sharper and "
        "noisier. Unused where textures are not filtered",
        group="TEXTURES",
        unit="footprints",
        minimum=0.01,
        maximum=16.0,
    )

    pixel_filter: str = setting(
        "BLACKMAN_HARRIS",
        "Pixel Filter",
        "Weight of the light around a pixel's centre",
        group="FILM",
        choices=(
            ("BLACKMAN_HARRIS", "Blackman-Harris", "Smooth, sharp, without ringing"),
            ("GAUSSIAN", "Gaussian", "Soft"),
            ("BOX", "Box", "The pixel's own square only"),
        ),
    )
    filter_width: float = setting(
        1.5,
        "Filter Width",
        "Width of the pixel filter; the box is one pixel wide always",
        group="FILM",
        unit="pixels",
        minimum=0.01,
        maximum=10.0,
    )
