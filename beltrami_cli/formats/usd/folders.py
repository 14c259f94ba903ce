"""Where the files of a USD scene are: in the folder of its root layer, or in its package."""

from __future__ import annotations

from pathlib import PurePosixPath

from beltrami_cli.formats.sidecars.model_folder import ModelFolder, UnfitReferenceError, is_outside
from beltrami_cli.formats.sidecars.tile_names import found_tiles, has_token
from beltrami_cli.formats.usd.package import Package
from beltrami_cli.surface.tiling import Tile

_TOP = PurePosixPath()


class UsdFolder(ModelFolder):
    """A folder; files outside of it are refused, since usd-core gets the layers in a folder of their own."""

    def locate(self, name: str, within: PurePosixPath = _TOP) -> str:
        located = super().locate(name, within)
        if is_outside(located):
            cause = "lies outside the model's folder, and USD files there are not read"
            remedy = "copy all files of the scene into one folder, or write it as one package (usdzip)"
            raise UnfitReferenceError(cause, remedy)
        return located


class PackageFolder(ModelFolder):
    """The files of a package, by their paths in it."""

    def __init__(self, package: Package) -> None:
        super().__init__(None)
        self._package = package

    def locate(self, name: str, within: PurePosixPath = _TOP) -> str:
        path = str(within / name)
        if path not in self._package.members:
            raise UnfitReferenceError("is not in the package")
        return path

    def locate_any(self, pattern: str, within: PurePosixPath = _TOP) -> str:
        if not has_token(pattern):
            return self.locate(pattern, within)
        path = str(within / pattern)
        if not self.tiles_of(path):
            raise UnfitReferenceError("is not in the package")
        return path

    def _find_tiles(self, path: PurePosixPath) -> dict[Tile, str]:
        members = map(PurePosixPath, self._package.members)
        names = [member.name for member in members if member.parent == path.parent]
        return {tile: str(path.with_name(name)) for tile, name in found_tiles(path.name, names).items()}

    def read(self, path: str, most: int = -1) -> bytes:
        return self._package.read(path)
