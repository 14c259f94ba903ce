"""Turntables as moving pictures: GIF by OpenImageIO, WebP by Pillow, MP4 by PyAV."""

from __future__ import annotations

import importlib
import io
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import ProcessingError
from beltrami_cli.formats.image.reading import scratch_file

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from beltrami_cli.arrays import Uint8s

    Frames = Sequence[Uint8s]  # of one size, (H, W, 3), or (H, W, 4) with opacity

_WEBP_QUALITY = 90
_MP4_QUALITY = "16"  # constant rate factor of H.264: what cannot be distinguished from the original


def encoded_animation(frames: Frames, suffix: str, rate: int) -> bytes:
    """Return frames as a file that plays them over and over, `rate` a second."""
    return _ENCODERS[suffix](frames, rate)


def require_encoder(suffix: str) -> None:
    """Raise ProcessingError, which says what to install, if a kind of animation cannot be written."""
    if suffix == ".webp":
        _imported("PIL.Image", suffix)
    elif suffix == ".mp4":
        _imported("av", suffix)


def _imported(module: str, suffix: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = {"PIL.Image": "Pillow", "av": "PyAV"}[module]
        raise ProcessingError(
            f"to write turntables as {suffix}, the package {package} is needed; "
            "install it with: pip install 'beltrami-cli[animation]'"
        ) from error


def _gif(frames: Frames, rate: int) -> bytes:
    import OpenImageIO

    height, width, channels = frames[0].shape
    spec = OpenImageIO.ImageSpec(width, height, channels, "uint8")
    spec.attribute("FramesPerSecond", OpenImageIO.TypeRational, (rate, 1))
    with scratch_file(suffix=".gif") as path:
        file = OpenImageIO.ImageOutput.create(str(path))
        if file is None or not file.open(str(path), (spec,) * len(frames)):
            raise ProcessingError(f"the GIF file cannot be written ({OpenImageIO.geterror()})")
        for number, frame in enumerate(frames):
            if number:
                file.open(str(path), spec, "AppendSubimage")
            file.write_image(np.ascontiguousarray(frame))
        file.close()
        return path.read_bytes()


def _webp(frames: Frames, rate: int) -> bytes:
    image = _imported("PIL.Image", ".webp")
    first, *others = [image.fromarray(frame) for frame in frames]
    data = io.BytesIO()
    first.save(
        data, "WEBP", save_all=True, append_images=others, duration=round(1000 / rate), loop=0,
        quality=_WEBP_QUALITY,
    )  # fmt: skip
    return data.getvalue()


def _mp4(frames: Frames, rate: int) -> bytes:
    av = _imported("av", ".mp4")
    height, width = frames[0].shape[:2]
    data = io.BytesIO()
    with av.open(data, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=Fraction(rate), options={"crf": _MP4_QUALITY})
        # Players want half the resolution of colour, and so even sides.
        stream.width, stream.height, stream.pix_fmt = width + width % 2, height + height % 2, "yuv420p"
        for frame in frames:
            even = np.pad(frame[..., :3], [(0, height % 2), (0, width % 2), (0, 0)], mode="edge")
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(even), "rgb24")))
        container.mux(stream.encode())
    return data.getvalue()


_ENCODERS: dict[str, Callable[[Frames, int], bytes]] = {".gif": _gif, ".webp": _webp, ".mp4": _mp4}
ANIMATIONS = tuple(_ENCODERS)
"""Suffixes of turntables that move."""
