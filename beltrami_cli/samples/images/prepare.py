"""An image file as samples of a manifold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access
from beltrami_cli.formats.image import read_image
from beltrami_cli.samples.images.colours import ImageColours
from beltrami_cli.samples.images.grid_flow import grid_flow
from beltrami_cli.samples.images.guides import GuideImage, read_guide_images
from beltrami_cli.samples.images.surface import read_surface
from beltrami_cli.samples.memory_check import require_room
from beltrami_cli.samples.settings import DEFAULTS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.flow.beltrami_flow import BeltramiFlow
    from beltrami_cli.flow.grid_manifold import GridManifold
    from beltrami_cli.formats.image import Picture
    from beltrami_cli.samples.images.surface import ImageSurface
    from beltrami_cli.samples.settings import SmoothSettings


@dataclass(frozen=True)
class PreparedImage:
    """An image as samples of a manifold.

    Attributes
    ----------
    picture : Picture
        Decoded.
    surface : ImageSurface
        Where its pixels lie.
    colours : ImageColours
        The way from pixels to samples and back.
    valid : ndarray of bool, shape (H, W)
        False at holes: where the mask or the surface says so, values are not finite, or nothing is seen.
    notices : tuple of str
        What the user should know, one sentence each.
    guides : tuple of GuideImage
        What enters the metric besides.
    """

    picture: Picture
    surface: ImageSurface
    colours: ImageColours
    valid: NDArray[np.bool_]
    notices: tuple[str, ...]
    guides: tuple[GuideImage, ...]

    def flow(self, settings: SmoothSettings) -> BeltramiFlow[GridManifold]:
        """Make the flow on these samples."""
        return grid_flow(
            self.valid,
            self.colours.samples,
            settings.kernel,
            positions=self.surface.positions,
            heights=self.surface.heights,
            guides=self.guides,
            metric_channels=self.colours.metric_channels,
        )

    def facts(self) -> dict[str, object]:
        """Return facts about the image in JSON types."""
        rows, columns = self.valid.shape
        return {
            "width": columns,
            "height": rows,
            "format": self.picture.format,
            "stored": self.picture.stored,
            "channels": list(self.picture.channels),
            "encoding": self.picture.encoding,
            "smoothed": list(self.colours.changing),
            "surface": self.surface.kind,
            "holes": self.valid.size - int(np.count_nonzero(self.valid)),
        }


def prepare_image(
    data: bytes, name: str, settings: SmoothSettings, access: Access = EVERYTHING_INSIDE
) -> PreparedImage:
    """Decode an image and find its surface and its holes.

    Parameters
    ----------
    data : bytes
        The file.
    name : str
        Its name for messages.
    settings : SmoothSettings
        The working space, the channels, alpha, and the images of the surface and of the guides.
    access : Access
        What may be read.

    Raises
    ------
    UsageError
        If the settings contradict the image, or are of meshes.
    InputError
        If it, or another image that is named, cannot be decoded, does not fit, or needs more memory than there is.
    """
    refuse_options_of_meshes(settings, name)
    require_room([(name, data)], access)
    picture = read_image(data, name, finite=False)
    colours = ImageColours(picture, settings)
    surface = read_surface(picture, settings.image, access)
    usable, visible = colours.usable(), colours.visible()
    valid = surface.valid & usable & visible
    notices = [*picture.notices, *surface.notices]
    unfit = usable.size - int(np.count_nonzero(usable))
    if unfit:
        notices.append(f"{name} has {unfit} pixels that are no finite numbers; they are holes, and stay.")
    if colours.others and settings.channels is None:
        notices.append(
            f"{name}: the channels {', '.join(colours.others)} are smoothed too, and count as differences; "
            "--channels leaves them out."
        )
    if not valid.any():
        notices.append(f"{name} has no pixel but holes, so nothing was smoothed.")
    guides = read_guide_images(picture, valid, settings, access)
    return PreparedImage(picture, surface, colours, valid, tuple(notices), guides)


def refuse_options_of_meshes(settings: SmoothSettings, name: str) -> None:
    """Refuse what can be said of meshes and their textures only.

    Raises
    ------
    UsageError
        With the options and the image's name.
    """
    textures, kernel = settings.textures, settings.kernel
    usual, usual_kernel = DEFAULTS.textures, DEFAULTS.kernel
    given = {
        "--on": settings.on != DEFAULTS.on,
        "--slots": textures.slots != usual.slots,
        "--material": textures.materials != usual.materials,
        "--texture": textures.names != usual.names,
        "--gutter": textures.gutter != usual.gutter,
        "--texture-format": textures.image_suffix != usual.image_suffix,
        "--weights": kernel.weights != usual_kernel.weights,
        "--max-samples": kernel.max_samples != usual_kernel.max_samples,
        "--smooth-geometry": settings.embedding.smooth_geometry,
    }
    wrong = [option for option, is_given in given.items() if is_given]
    if not wrong:
        return
    remedy = (
        "end the name of OUTPUT in the extension instead" if "--texture-format" in wrong else "leave it out"
    )
    raise UsageError(f"{', '.join(wrong)}: for meshes only, but {name} is an image; {remedy}")
