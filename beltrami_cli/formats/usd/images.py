"""The images of a USD scene: their paths, and the paths of new ones."""

from __future__ import annotations

import posixpath
from collections import defaultdict
from collections.abc import Mapping, Sequence

from beltrami_cli.errors import InputError, Obstacle, UsageError
from beltrami_cli.formats.changes import Naming, NewImages, Written
from beltrami_cli.formats.image.file_formats import format_of, format_of_suffix
from beltrami_cli.formats.sidecars.model_folder import UnfitReferenceError
from beltrami_cli.formats.sidecars.new_files import (
    NewFiles,
    Replacement,
    common_suffix,
    new_paths,
    replacements,
)
from beltrami_cli.formats.usd.contents import SceneContents
from beltrami_cli.formats.usd.layers import Layers
from beltrami_cli.formats.usd.package import IMAGES
from beltrami_cli.surface.records import ImageFile, Slot


class Images:
    """The images that a scene refers to."""

    def __init__(self, contents: SceneContents, layers: Layers, name: str) -> None:
        self._contents, self._layers, self._name = contents, layers, name
        self.paths: dict[str, str] = {}  # of images and tile sets, by their names in the scene
        self.obstacles: dict[str, Obstacle] = {}  # why other images are not read, by name
        for file in dict.fromkeys([*(use.file for use in contents.uses), *contents.images.values()]):
            try:
                self.paths[file] = layers.folder.locate_any(file)
            except UnfitReferenceError as error:
                self.obstacles[file] = error.obstacle

    def files(self) -> dict[str, str]:
        """Return every image file, by the slot or the attribute that refers to it."""
        named = {attribute: self.paths.get(file) for attribute, file in self._contents.images.items()}
        return self._layers.folder.files_by_label(named)

    def _attributes(self, path: str, slots: Sequence[Slot] | None = None) -> set[str]:
        """Return the attributes that refer to a path, in some slots or in all places."""
        paths = self.paths
        if slots is None:
            return {name for name, file in self._contents.images.items() if paths.get(file) == path}
        shown = [use for use in self._contents.uses if use.slot in slots]
        return {use.attribute for use in shown if paths.get(use.file) == path}

    def _replacements(self, images: NewImages) -> list[Replacement]:
        def paths_of(slot: Slot, file: str) -> list[str]:
            shown = [use.file for use in self._contents.uses if use.slot == slot]
            paths = dict.fromkeys(self.paths[name] for name in shown if name in self.paths)
            return [path for path in paths if file in self._layers.folder.files(path)]

        return replacements(images, paths_of)

    def _copied(self, images: NewImages, naming: Naming) -> list[str]:
        """Return the files that an output in another folder needs copies of: other layers, and images that stay."""
        if not naming.is_moved or self._layers.package is not None:
            return []
        slots_of: dict[str, list[Slot]] = defaultdict(list)
        for each in self._replacements(images):
            slots_of[each.path] += each.slots
        gone = [
            path
            for path, slots in slots_of.items()
            if self._attributes(path, slots) == self._attributes(path)
        ]
        replaced = {file for path in gone for file in self._layers.folder.files(path)}
        images_left = [file for file in dict.fromkeys(self.files().values()) if file not in replaced]
        copied = [*self._layers.others, *images_left]
        taken = next((file for file in copied if naming.is_taken(file)), None)
        if taken is not None:  # other layers refer to the copied files
            cause = f"there is another '{taken}' in OUTPUT's folder, and one of its files needs that name"
            raise InputError(self._name, cause, "choose an empty folder")
        return copied

    def renamed(self, images: NewImages, naming: Naming) -> tuple[Written, dict[str, str]]:
        """Return the new files of the root layer or package, and the attributes with the new names."""
        copied = self._copied(images, naming)
        present = self._layers.package.members if self._layers.package else self.references()
        names = NewFiles(naming, self._name, present, [*self.obstacles, *copied])
        names.copies |= {file: file for file in copied}
        renamed: dict[str, str] = {}
        for each in self._replacements(images):
            attributes = self._attributes(each.path, each.slots)
            is_replaced = attributes == self._attributes(each.path)
            new = self._add_new(each.path, each.files, names, is_replaced=is_replaced)
            if new != each.path:
                start = posixpath.dirname(self._layers.root) or "."
                renamed |= dict.fromkeys(attributes, "./" + posixpath.relpath(new, start))
        if self._layers.package is not None:
            names.sidecars |= {new: self._layers.folder.content(old) for new, old in names.copies.items()}
        return names.written(), renamed

    def _add_new(self, path: str, new: Mapping[str, ImageFile], names: NewFiles, *, is_replaced: bool) -> str:
        """Add the files of a new image or tile set to the new files, and return its path."""
        for attribute in sorted(self._attributes(path) - {use.attribute for use in self._contents.uses}):
            names.note_stale_use(attribute, path)
        new_path = self._new_path(path, new, names, is_replaced=is_replaced)
        new_of = new_paths(path, new_path, self._layers.folder.tiles_of(path))
        names.sidecars |= {new_of.pop(file): image.content for file, image in new.items()}
        names.copies |= {file: old for old, file in new_of.items() if file != old}
        return new_path

    def _new_path(
        self, path: str, new: Mapping[str, ImageFile], names: NewFiles, *, is_replaced: bool
    ) -> str:
        """Return the path of a new image or tile set: in a package the old path, if the type is the same."""
        suffixes = {image.suffix for image in new.values()}
        formats = {format_of(self._layers.folder.content(file), file) for file in new}
        stays = {format_of_suffix(suffix) for suffix in suffixes} == formats
        if self._layers.package is not None and is_replaced and stays:
            return path
        unfit = suffixes - {*IMAGES}
        if self._layers.package is not None and unfit and not stays:
            raise UsageError(f"packages hold no {min(unfit)} images; choose {', '.join(IMAGES)}", self._name)
        suffix = common_suffix(suffixes)
        tiles = self._layers.folder.tiles_of(path)
        return names.image(path, None if stays else suffix, is_replaced=is_replaced, tiles=tiles)

    def references(self) -> list[str]:
        """Return the sidecar files of a scene that is not a package: other layers and images."""
        return [*self._layers.others, *dict.fromkeys(self.files().values())]
