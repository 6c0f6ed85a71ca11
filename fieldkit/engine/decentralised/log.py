"""One append-only log, of which all but the latest entries are kept packed: hours of it fit into a few megabytes. Pure.

Nothing is forgotten: a robot that has lost its disk gets everything back from any other, and steps through it anew.
"""

import operator
from collections.abc import Iterable, Iterator, Sequence
from typing import overload

from fieldkit.engine.decentralised import packing
from fieldkit.engine.decentralised.entries import Entry, Part, Stream

CHUNK = 256
"""Entries packed together."""
RECENT = 512
"""So many of the latest are left as they are."""


class Log(Sequence[Entry]):
    """A sequence of `packing.quantised` observations that only grows."""

    def __init__(self, robot: str, stream: Stream, entries: Iterable[Entry] = ()) -> None:
        self._robot, self._stream = robot, stream
        self._kept: tuple[tuple[bytes, ...], list[Entry]] = ((), [])
        """Chunks, and what came after them. Replaced as one: a reader in another thread never sees half a change."""
        self._opened: tuple[int, tuple[Entry, ...]] = (-1, ())
        """The chunk that was read last: readers go on where they were."""
        self.extend(entries)

    def append(self, entry: Entry) -> None:
        """Add one."""
        chunks, recent = self._kept
        recent.append(entry)
        if len(recent) >= RECENT + CHUNK:
            out = packing.Bytes()
            part = Part(self._robot, self._stream, 0, tuple(recent[:CHUNK]))
            packing.pack_part(out, part, (self._robot,), 0)
            self._kept = ((*chunks, bytes(out.data)), recent[CHUNK:])

    def extend(self, entries: Iterable[Entry]) -> None:
        """Add several."""
        for entry in entries:
            self.append(entry)

    @property
    def packed_bytes(self) -> int:
        """What the packed ones take."""
        return sum(map(len, self._kept[0]))

    def __len__(self) -> int:
        chunks, recent = self._kept
        return len(chunks) * CHUNK + len(recent)

    @overload
    def __getitem__(self, index: int) -> Entry: ...
    @overload
    def __getitem__(self, index: slice) -> list[Entry]: ...
    def __getitem__(self, index: int | slice) -> Entry | list[Entry]:
        if isinstance(index, slice):
            return [self._at(number) for number in range(*index.indices(len(self)))]
        number = index + len(self) if index < 0 else index
        if not 0 <= number < len(self):
            raise IndexError(f"log: there is no entry {index} of {len(self)}")
        return self._at(number)

    def up_to(self, end_ns: int, first: int = 0) -> list[Entry]:
        """From entry `first` on, those up to a time."""
        found: list[Entry] = []
        for number in range(first, len(self)):
            entry = self._at(number)
            if entry.order_ns > end_ns:
                break
            found.append(entry)
        return found

    def __iter__(self) -> Iterator[Entry]:
        return (self._at(number) for number in range(len(self)))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and len(self) == len(other) and all(map(operator.eq, self, other))

    def _at(self, number: int) -> Entry:
        chunks, recent = self._kept
        chunk, within = divmod(number, CHUNK)
        if chunk >= len(chunks):
            return recent[number - len(chunks) * CHUNK]
        opened = self._opened
        if opened[0] != chunk:
            part = packing.unpack_part(packing.Reader(chunks[chunk]), (self._robot,), 0)
            self._opened = opened = (chunk, part.entries)
        return opened[1][within]
