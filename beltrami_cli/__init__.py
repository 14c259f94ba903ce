"""Smooth the colours of a surface with the short-time Beltrami kernel.

`smooth` takes the arrays of a mesh or a point cloud, or a mesh of trimesh, Open3D or PyVista, `smooth_textured` a mesh
with its images, and `smooth_image` the pixels of an image; the functions whose names end in `_file` or `_files` do what
the commands do. `SmoothSettings` and the records in it hold the parameters with their defaults, which keywords
override; `ImageSurface` holds where the pixels of an image lie, and `Job` what may be read and written. Importing the
package loads nothing heavy: names are resolved when they are used.
"""

# With ``python -m beltrami_cli`` the working folder comes first on the path until `__main__` takes it off, so nothing
# is imported here: type checkers take this name as that of `typing`.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from beltrami_cli.errors import BeltramiError as BeltramiError
    from beltrami_cli.errors import InputError as InputError
    from beltrami_cli.errors import OutputError as OutputError
    from beltrami_cli.errors import ProcessingError as ProcessingError
    from beltrami_cli.errors import UsageError as UsageError
    from beltrami_cli.flow.parameters import KernelParameters as KernelParameters
    from beltrami_cli.formats.files.access import Access as Access
    from beltrami_cli.jobs.arrays.image import ImageResult as ImageResult
    from beltrami_cli.jobs.arrays.image import smooth_image as smooth_image
    from beltrami_cli.jobs.arrays.mesh import SmoothResult as SmoothResult
    from beltrami_cli.jobs.arrays.mesh import smooth as smooth
    from beltrami_cli.jobs.arrays.mesh_arrays import MeshArrays as MeshArrays
    from beltrami_cli.jobs.arrays.textured import TexturedResult as TexturedResult
    from beltrami_cli.jobs.arrays.textured import smooth_textured as smooth_textured
    from beltrami_cli.jobs.bake import BakeReport as BakeReport
    from beltrami_cli.jobs.bake import bake_file as bake_file
    from beltrami_cli.jobs.check import CheckReport as CheckReport
    from beltrami_cli.jobs.check import check_files as check_files
    from beltrami_cli.jobs.compare.files import Comparison as Comparison
    from beltrami_cli.jobs.compare.files import compare_files as compare_files
    from beltrami_cli.jobs.inspect import inspect_file as inspect_file
    from beltrami_cli.jobs.job import Job as Job
    from beltrami_cli.jobs.level import LevelFileReport as LevelFileReport
    from beltrami_cli.jobs.level import level_file as level_file
    from beltrami_cli.jobs.noise.file import NoiseReport as NoiseReport
    from beltrami_cli.jobs.noise.file import noise_file as noise_file
    from beltrami_cli.jobs.settings import BakeSettings as BakeSettings
    from beltrami_cli.jobs.settings import Limits as Limits
    from beltrami_cli.jobs.settings import NoiseSettings as NoiseSettings
    from beltrami_cli.jobs.smooth import smooth_file as smooth_file
    from beltrami_cli.jobs.smooth_report import SmoothReport as SmoothReport
    from beltrami_cli.layers.image_surface import ImageSurface as ImageSurface
    from beltrami_cli.layers.settings import EmbeddingSettings as EmbeddingSettings
    from beltrami_cli.layers.settings import ImageSettings as ImageSettings
    from beltrami_cli.layers.settings import LevelSetSettings as LevelSetSettings
    from beltrami_cli.layers.settings import LevelSettings as LevelSettings
    from beltrami_cli.layers.settings import SmoothSettings as SmoothSettings
    from beltrami_cli.layers.settings import TextureSettings as TextureSettings
    from beltrami_cli.view.render import render_file as render_file
    from beltrami_cli.view.settings import RenderSettings as RenderSettings

    __version__: str

_NAMES_IN = {
    "errors": "BeltramiError InputError OutputError ProcessingError UsageError",
    "flow.parameters": "KernelParameters",
    "formats.files.access": "Access",
    "jobs.arrays.image": "ImageResult smooth_image",
    "jobs.arrays.mesh": "SmoothResult smooth",
    "jobs.arrays.mesh_arrays": "MeshArrays",
    "jobs.arrays.textured": "TexturedResult smooth_textured",
    "jobs.bake": "BakeReport bake_file",
    "jobs.check": "CheckReport check_files",
    "jobs.compare.files": "Comparison compare_files",
    "jobs.inspect": "inspect_file",
    "jobs.job": "Job",
    "jobs.level": "LevelFileReport level_file",
    "jobs.noise.file": "NoiseReport noise_file",
    "jobs.settings": "BakeSettings Limits NoiseSettings",
    "jobs.smooth": "smooth_file",
    "jobs.smooth_report": "SmoothReport",
    "layers.image_surface": "ImageSurface",
    "layers.settings": "EmbeddingSettings ImageSettings LevelSetSettings LevelSettings SmoothSettings TextureSettings",
    "view.render": "render_file",
    "view.settings": "RenderSettings",
}
_HOME_OF = {name: module for module, names in _NAMES_IN.items() for name in names.split()}

__all__ = sorted(_HOME_OF)


def __getattr__(name: str) -> object:
    import importlib

    if name == "__version__":
        from importlib.metadata import version

        return version("beltrami-cli")
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME_OF[name]}"), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
