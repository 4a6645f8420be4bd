"""What differs from row to row of a batch of one crane: where it stands in what compiled code is given, and what it may
be.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .description import Description, check_rod, check_value, range_of
from .effects import registry
from .errors import CraneError, nearest


@dataclass(frozen=True)
class _Plan:
    """Where some parameters stand, and what they may be.

    Attributes:
        places: (number of the table among P, E and w, column) of each.
        tables: of each table that they stand in: (table, which of the parameters (k,), their columns (k,), what they
            are above (k, 1)).
        rods: (column of the bore, of the rod) in P of cylinders of which one of these differs.
    """

    names: tuple[str, ...]
    places: tuple[tuple[int, int], ...]
    tables: tuple[tuple[int, np.ndarray, np.ndarray, np.ndarray], ...]
    rods: tuple[tuple[int, int], ...]


class RowValues:
    """What differs from row to row of a batch: it is put where compiled code looks for it, and must be possible.

    Effects are bounded from below only, as a filter's sigma points are: beyond its range one is odd, not impossible.
    """

    def __init__(self, crane: Description) -> None:
        self._crane = crane
        self._plans: dict[tuple[str, ...], _Plan] = {}  # the names are the same step after step

    def differing(self, names: tuple[str, ...]) -> set[int]:
        """Return which of the tables P (0), E (1) and w (2) parameters of such names stand in. Raises CraneError for an
        unknown one.
        """
        return {table for table, *_ in self._planned(names).tables}

    def fill(self, parameters: Mapping[str, np.ndarray], P: np.ndarray, E: np.ndarray, w: np.ndarray) -> None:
        """Write values (n,) by name into P (n, .), E (n, .) and, disturbances, w (2, n, .); what does not differ may
        have one row.

        Raises:
            CraneError: an unknown name, not one number a row, or a row that no crane can have.
        """
        plan, filled = self._planned(tuple(parameters)), (P, E, w)
        values, possible = _in_rows(parameters, _rows(filled)), True
        for table, own, columns, least in plan.tables:
            there = values[own]
            filled[table][..., columns] = there.T
            possible = possible and bool(((there > least) & (there < math.inf)).all())
        if not (possible and all((P[:, bore] > P[:, rod]).all() for bore, rod in plan.rods)):
            self._refuse(plan, filled)

    def _planned(self, names: tuple[str, ...]) -> _Plan:
        plan = self._plans.get(names)
        if plan is None:
            plan = self._plans[names] = self._plan(names)
        return plan

    def _plan(self, names: tuple[str, ...]) -> _Plan:
        places, index = tuple(map(self._place, names)), self._crane.machine.index
        tables = []
        for table in sorted({table for table, _ in places}):
            own = [i for i, (t, _) in enumerate(places) if t == table]
            least = [-math.inf if table == 2 else self._below(names[i]) for i in own]
            columns = np.array([places[i][1] for i in own])
            tables.append((table, np.array(own), columns, np.array(least)[:, None]))
        ends = [(f"cylinders.{c}.bore", f"cylinders.{c}.rod") for c in self._crane.layout.cylinders]
        rods = tuple((index[bore], index[rod]) for bore, rod in ends if bore in names or rod in names)
        return _Plan(names, places, tuple(tables), rods)

    def _place(self, name: str) -> tuple[int, int]:
        layout, index = self._crane.layout, self._crane.machine.index
        if name in index:
            return 0, index[name]
        if name in layout.disturbances:
            return 2, layout.all_inputs.index(name)
        return 1, _effect_column(self._crane, name)

    def _below(self, name: str) -> float:
        """Return what a parameter must be above; infinite where it has a few choices, at which `_refuse` looks."""
        if name in self._crane.machine.index:
            least, allowed, choices = range_of(name)
            return math.inf if choices else math.nextafter(least, -math.inf) if allowed else least
        return math.nextafter(self._least_of(name), -math.inf)

    def _least_of(self, name: str) -> float:
        key, _, last = name.rpartition(".")
        effect, _ = registry.split_key(key, self._crane.layout)
        return next(float(p.lower) for p in effect.parameters if p.name == last)

    def _refuse(self, plan: _Plan, tables: tuple[np.ndarray, ...]) -> None:
        """Raise CraneError for the first row that is impossible."""
        of, (P, E, _) = self._crane.machine.index, tables
        for row in range(_rows(tables)):
            where, values = f"parameters, row {row}", P[row % len(P)].tolist()
            for name, (table, column) in zip(plan.names, plan.places, strict=True):
                if table == 0:
                    check_value(where, name, values[column])
                elif table == 1:
                    value, least = float(E[row % len(E), column]), self._least_of(name)
                    if not least <= value < math.inf:
                        raise CraneError(
                            f"{where}: {name} = {value:g} is impossible: it must be finite and >= {least:g}. Keep "
                            "every row there."
                        )
            for c in self._crane.layout.cylinders:
                check_rod(where, c, values[of[f"cylinders.{c}.bore"]], values[of[f"cylinders.{c}.rod"]])


def _in_rows(parameters: Mapping[str, np.ndarray], rows: int) -> np.ndarray:
    """Return the values (k, rows) of parameters, each given for every row or once for all.

    Raises:
        CraneError: one has another shape.
    """
    try:
        values = np.array([*parameters.values()], dtype=float)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.shape == (len(parameters), rows):
        return values
    values = np.empty((len(parameters), rows))
    for row, (name, given) in zip(values, parameters.items(), strict=True):
        try:
            if np.ndim(given) > 1:
                raise ValueError
            row[:] = given
        except (TypeError, ValueError):
            raise CraneError(
                f"parameters: {name!r} has the shape {np.shape(given)}, expected ({rows},) numbers in SI. Give one for "
                "each row of the states."
            ) from None
    return values


def _rows(tables: tuple[np.ndarray, ...]) -> int:
    return max(table.shape[-2] for table in tables)


def _effect_column(crane: Description, name: str) -> int:
    """Return where in E the parameter "effect@place.parameter" stands.

    Raises:
        CraneError: there is no such parameter, neither of an effect nor of the crane.
    """
    key, _, parameter = name.rpartition(".")
    if not key or key.split("@")[0] not in [e.name for e in registry.known()]:
        known = [*crane.machine.names, *crane.layout.disturbances]
        raise CraneError(f"parameters: there is no {name!r}.{nearest(name, known)}")
    effect, place = registry.split_key(key, crane.layout)
    names = [p.name for p in effect.parameters]
    if parameter not in names:
        raise CraneError(f"parameters: effect {key!r} has no parameter {parameter!r}.{nearest(parameter, names)}")
    return registry.slot(effect.name, place, crane.layout) + names.index(parameter)
