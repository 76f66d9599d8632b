"""Tasks by their numbers in a study's list: small to keep and to send, made where they are done."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from ctrplan.studies.study.task import KEY_DIGITS, Task, TaskList

KEY_BYTES = KEY_DIGITS // 2


@dataclass(frozen=True)
class Numbered:
    """Tasks of a list: their numbers in it, their places in the table and their keys, KEY_BYTES each."""

    numbers: array[int]
    indices: array[int]
    keys: bytes | bytearray

    @classmethod
    def none(cls) -> Numbered:
        """To which some may be added."""
        return cls(array("q"), array("q"), bytearray())

    def __len__(self) -> int:
        """Number of tasks."""
        return len(self.numbers)

    def add(self, number: int, index: int, key: bytes) -> None:
        """One more. Only of those that began as none."""
        assert isinstance(self.keys, bytearray)
        self.numbers.append(number)
        self.indices.append(index)
        self.keys.extend(key)

    def chunks(self, sizes: Iterable[int]) -> Iterator[Numbered]:
        """All of them in their order, so many at a time."""
        begin = 0
        for size in sizes:
            end = min(begin + size, len(self))
            if begin == end:
                return
            yield self._some(begin, end)
            begin = end

    def of(self, tasks: TaskList) -> list[Task]:
        """The tasks."""
        keys = (self.keys[k : k + KEY_BYTES].hex() for k in range(0, len(self.keys), KEY_BYTES))
        found = zip(self.numbers, self.indices, keys, strict=True)
        return [tasks.made(number, index, key) for number, index, key in found]

    def _some(self, begin: int, end: int) -> Numbered:
        keys = bytes(self.keys[begin * KEY_BYTES : end * KEY_BYTES])
        return Numbered(self.numbers[begin:end], self.indices[begin:end], keys)
