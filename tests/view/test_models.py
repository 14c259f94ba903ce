"""The models of pages are valid binary glTF files."""

from __future__ import annotations

import pytest

from beltrami_cli.formats.access import EVERYTHING_INSIDE
from beltrami_cli.jobs.file_job import open_input
from beltrami_cli.layers.settings import DEFAULTS
from beltrami_cli.view.models import ModelWriter
from cli.commands import SAMPLES
from formats.gltf_validator import issues, needs_validator


@pytest.mark.slow
@needs_validator
def test_models_of_pages_are_valid_gltf(tmp_path):
    cloud = tmp_path / "cloud.xyz"
    cloud.write_text(
        "".join(f"{x} {y} 0 200 30 30\n" for x in range(9) for y in range(9))
        + "900 0 0 200 30 30\n1e60 0 0 200 30 30\n"
    )
    files = []
    for source in (
        cloud,
        *(SAMPLES / each for each in ("knot-noisy.ply", "torus-two-noisy.gltf", "scan-clean.jpg")),
    ):
        document = open_input(str(source), DEFAULTS, EVERYTHING_INSIDE)
        writer, is_image = ModelWriter(), document.kind == "image"
        writer.add((document, document), None if is_image else next(iter(document.slots()), None))
        files.append(tmp_path / f"{source.stem}.glb")
        files[-1].write_bytes(writer.glb(8))
    for path, found in zip(files, issues(*files), strict=True):
        assert [each for each in found if each[0] < 2] == [], path.name  # errors and warnings
