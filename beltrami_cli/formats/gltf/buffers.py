"""The buffers of a glTF file: where each one's bytes come from, read or decoded when they are first needed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from beltrami_cli.formats.gltf.files import is_data, read, relative_name
from beltrami_cli.formats.model_folder import UnfitReferenceError, remedy_for

if TYPE_CHECKING:
    from collections.abc import Callable

    from beltrami_cli.formats.document import Bytes
    from beltrami_cli.formats.gltf.container import Container
    from beltrami_cli.formats.model_folder import ModelFolder

Source = Literal["chunk", "data", "file", "nowhere", "decoded"]


class Buffers:
    """All buffers of one file, and those that stand for what is decoded from them.

    Parameters
    ----------
    container : Container
        The file.
    beside : ModelFolder
        Where external buffers are looked for.

    Raises
    ------
    InputError
        If a buffer is described wrongly. Missing bytes are reported only when they are asked for.
    """

    def __init__(self, container: Container, beside: ModelFolder) -> None:
        self._container, self._beside = container, beside
        self._entries = container.root.entries("buffers")
        self._loaded: dict[int, Bytes] = {}
        self._decoded: list[tuple[int, Callable[[], Bytes]]] = []
        self.lengths = [entry.integer("byteLength", least=0) for entry in self._entries]
        self.uris = [entry.text("uri") for entry in self._entries]
        first: dict[str, int] = {}
        self._canonical = [first.setdefault(self._key(index), index) for index in range(len(self))]

    def __len__(self) -> int:
        return len(self._entries)

    def add(self, length: int, decode: Callable[[], Bytes]) -> int:
        """Add a buffer whose bytes are made when they are asked for; its number is beyond those of the JSON."""
        self._decoded.append((length, decode))
        return len(self) + len(self._decoded) - 1

    def length(self, index: int) -> int:
        """Return how many bytes a buffer has."""
        return self.lengths[index] if index < len(self) else self._decoded[index - len(self)][0]

    def _key(self, index: int) -> str:
        uri = self.uris[index]
        try:
            if uri is not None and not is_data(uri):
                return relative_name(uri, outside=self._beside.access.outside)
        except UnfitReferenceError:
            pass  # whoever asks for its bytes is told
        return f"\0{index}"

    def canonical(self, index: int) -> int:
        """Return the first buffer that is the same file as this one, usually itself."""
        return self._canonical[index] if index < len(self) else index

    def source(self, index: int) -> Source:
        """Return where a buffer's bytes are: in the BIN chunk, in a data URI, in a file, decoded, or nowhere."""
        if index >= len(self):
            return "decoded"
        uri = self.uris[index]
        if uri is not None:
            return "data" if is_data(uri) else "file"
        return "chunk" if index == 0 and self._container.binary is not None else "nowhere"

    def stored(self, index: int) -> Bytes:
        """Return all bytes of a buffer, at least as many as its byteLength says (padding may follow).

        Raises
        ------
        InputError
            If there are fewer, or the file cannot be read.
        """
        if index not in self._loaded:
            made = self.source(index) == "decoded"
            self._loaded[index] = self._decoded[index - len(self)][1]() if made else self._read(index)
        return self._loaded[index]

    def _read(self, index: int) -> Bytes:
        entry, uri = self._entries[index], self.uris[index]
        if uri is not None:
            try:
                data: Bytes = read(uri, self._beside)
            except UnfitReferenceError as error:
                raise entry.fault("uri", str(error), remedy_for(str(error))) from None
        elif self.source(index) == "chunk":
            data = self._container.binary or b""
        else:
            raise entry.fault("", "has neither a uri nor a BIN chunk, so it has no bytes")
        if len(data) < self.lengths[index]:
            cause = f"is {self.lengths[index]}, but there are only {len(data)} bytes"
            raise entry.fault("byteLength", cause, "the file may be cut short: copy or export it again")
        return data

    @property
    def bytes_at_hand(self) -> int:
        """Bytes of the main file and of all buffers that were read: the measure of what may be allocated."""
        return len(self._container.data) + sum(len(data) for data in self._loaded.values())
