"""Settings of denoising, which follows a render: they change the picture that is shown, and never the film's sums."""

from __future__ import annotations

from dataclasses import dataclass

from .info import setting


@dataclass(frozen=True)
class DenoiseSettings:
    """Whether a finished picture is denoised, and by what it is guided."""

    denoise: str = setting(
        "OFF",
        "Denoise",
        "Remove the noise of the finished picture with Open Image Denoise, on the CPU. The noisy picture stays, as the "
        "pass Noisy Image",
        group="DENOISING",
        choices=(
            ("OFF", "Off", "The picture is the mean of its samples"),
            (
                "ON",
                "On",
                "A neural network guesses the picture from its samples: smooth at once, with an error of its own that "
                "more samples make smaller",
            ),
        ),
    )
    denoise_inputs: str = setting(
        "ALBEDO_NORMAL",
        "Passes",
        "What the denoiser sees beside the picture itself, to find edges and textures. These passes are rendered too",
        group="DENOISING",
        choices=(
            ("NONE", "Color", "The picture alone: fine textures get lost"),
            ("ALBEDO", "Albedo", "The picture and its pass Denoising Albedo"),
            ("ALBEDO_NORMAL", "Albedo, Normal", "The picture and its passes Denoising Albedo and Denoising Normal"),
        ),
    )
    denoise_prefilter: str = setting(
        "ACCURATE",
        "Prefilter",
        "Whether noise in the guiding passes is removed first. Unused without guiding passes",
        group="DENOISING",
        choices=(
            ("NONE", "None", "Guiding passes are taken as free of noise: for scenes in which nothing blurs them"),
            ("FAST", "Fast", "Picture and guiding passes are denoised at once: quicker, and less sharp"),
            ("ACCURATE", "Accurate", "Guiding passes are denoised first, then the picture"),
        ),
    )
    denoise_quality: str = setting(
        "HIGH",
        "Quality",
        "Which network denoises",
        group="DENOISING",
        choices=(
            ("FAST", "Fast", "The smallest network"),
            ("BALANCED", "Balanced", "Between the two"),
            ("HIGH", "High", "The largest network"),
        ),
    )
    denoise_library: str = setting(
        "",
        "Library",
        "Path of the library Open Image Denoise, or of its folder; empty finds Blender's own",
        group="DENOISING",
    )
