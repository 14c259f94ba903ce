"""Smooth the colours painted on a surface with the short-time Beltrami kernel.

`smooth` takes the arrays of a mesh or a point cloud, `smooth_image` those of an image; `smooth_file` and `inspect_file`
take files. `SmoothSettings` and the records in it hold the parameters with their defaults, which keywords override;
`ImageSurface` holds where the pixels of an image lie, and `Job` what may be read and written. Importing the package
loads nothing heavy: names are resolved when they are used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from beltrami_cli.errors import BeltramiError, InputError, OutputError, ProcessingError, UsageError
    from beltrami_cli.flow.parameters import KernelParameters
    from beltrami_cli.formats.access import Access
    from beltrami_cli.jobs.arrays import ImageResult, SmoothResult, smooth, smooth_image
    from beltrami_cli.jobs.inspect import inspect_file
    from beltrami_cli.jobs.job import Job
    from beltrami_cli.jobs.level import LevelFileReport, level_file
    from beltrami_cli.jobs.noise import NoiseReport, noise_file
    from beltrami_cli.jobs.settings import BakeSettings, NoiseSettings
    from beltrami_cli.jobs.smooth import smooth_file
    from beltrami_cli.jobs.smoothing import SmoothReport
    from beltrami_cli.samples.image_surface import ImageSurface
    from beltrami_cli.samples.settings import (
        EmbeddingSettings,
        ImageSettings,
        LevelSetSettings,
        LevelSettings,
        SmoothSettings,
        TextureSettings,
    )

_HOME_OF = {
    "Access": "formats.access",
    "BakeSettings": "jobs.settings",
    "BeltramiError": "errors",
    "EmbeddingSettings": "samples.settings",
    "ImageResult": "jobs.arrays",
    "ImageSettings": "samples.settings",
    "ImageSurface": "samples.image_surface",
    "InputError": "errors",
    "Job": "jobs.job",
    "KernelParameters": "flow.parameters",
    "LevelFileReport": "jobs.level",
    "LevelSetSettings": "samples.settings",
    "LevelSettings": "samples.settings",
    "NoiseReport": "jobs.noise",
    "NoiseSettings": "jobs.settings",
    "OutputError": "errors",
    "ProcessingError": "errors",
    "SmoothReport": "jobs.smoothing",
    "SmoothResult": "jobs.arrays",
    "SmoothSettings": "samples.settings",
    "TextureSettings": "samples.settings",
    "UsageError": "errors",
    "inspect_file": "jobs.inspect",
    "level_file": "jobs.level",
    "noise_file": "jobs.noise",
    "smooth": "jobs.arrays",
    "smooth_file": "jobs.smooth",
    "smooth_image": "jobs.arrays",
}

__all__ = [
    "Access",
    "BakeSettings",
    "BeltramiError",
    "EmbeddingSettings",
    "ImageResult",
    "ImageSettings",
    "ImageSurface",
    "InputError",
    "Job",
    "KernelParameters",
    "LevelFileReport",
    "LevelSetSettings",
    "LevelSettings",
    "NoiseReport",
    "NoiseSettings",
    "OutputError",
    "ProcessingError",
    "SmoothReport",
    "SmoothResult",
    "SmoothSettings",
    "TextureSettings",
    "UsageError",
    "inspect_file",
    "level_file",
    "noise_file",
    "smooth",
    "smooth_file",
    "smooth_image",
]


def __getattr__(name: str) -> object:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME_OF[name]}"), name)
