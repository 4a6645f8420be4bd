"""Mappings that nobody can change, and that can be copied and sent to other processes all the same."""

from __future__ import annotations

import copyreg
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, TypeVar

from .errors import CraneError

K = TypeVar("K")
V = TypeVar("V")


def frozen(mapping: Mapping[K, V]) -> Mapping[K, V]:
    """Return a read-only copy of a mapping."""
    return MappingProxyType(AdvisingDict(mapping, mapping.said) if isinstance(mapping, AdvisingDict) else dict(mapping))


class AdvisingDict(dict[K, V]):
    """A dict that says what to do where an entry is missing: `said` with the name of the entry in place of {}."""

    def __init__(self, mapping: Mapping[K, V], said: str) -> None:
        super().__init__(mapping)
        self.said = said

    def __missing__(self, name: K) -> V:
        raise CraneError(self.said.format(name))

    def copy(self) -> AdvisingDict[K, V]:
        """Return another one with the same entries."""
        return AdvisingDict(self, self.said)

    def __reduce__(self) -> tuple[Any, tuple[dict[K, V], str]]:
        return AdvisingDict, (dict(self), self.said)


def _parts(mapping: MappingProxyType[Any, Any]) -> tuple[Any, tuple[dict[Any, Any]]]:
    return frozen, (mapping.copy(),)


copyreg.pickle(MappingProxyType, _parts)  # Python itself neither copies nor pickles them
