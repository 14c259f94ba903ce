"""Images: every pixel through OpenImageIO, every byte of metadata carried over."""

from beltrami_cli.formats.image.conversion import losses
from beltrami_cli.formats.image.picture import Picture, from_float, to_float
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.image.recognition import format_of, format_of_suffix
from beltrami_cli.formats.image.writing import write_image

__all__ = [
    "Picture",
    "format_of",
    "format_of_suffix",
    "from_float",
    "losses",
    "read_image",
    "to_float",
    "write_image",
]
