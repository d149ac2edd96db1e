"""One table for every approximation: what it costs beside what it loses."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import rich.table

from torchprt.errors import InputError
from torchprt.files import atomic
from torchprt.measure.time import Timing


@dataclass(frozen=True)
class Row:
    """One method: relative `error` beside its `seconds` and `bytes`, None where not measured.

    `seconds` may be a `Timing`, whose spread is then shown. `extra`: further columns by heading.
    """

    name: str
    error: float | None = None
    seconds: float | Timing | None = None
    bytes: int | None = None
    extra: Mapping[str, float | int | str] = field(default_factory=dict)


@dataclass
class Table:
    """Rows under one title. Prints with rich; `to_csv` and `to_json` keep full precision."""

    title: str
    rows: list[Row] = field(default_factory=list)

    def add(self, name: str, **values: Any) -> Row:
        """Appends `Row(name, **values)` and returns it. Raises InputError if the name is taken."""
        if any(row.name == name for row in self.rows):
            raise InputError(f"table '{self.title}' already has a row '{name}': give another name")
        row = Row(name, **values)
        self.rows.append(row)
        return row

    def __rich__(self) -> rich.table.Table:
        records = self.records()
        shown = [name for name in _headings(records) if name != "spread"]
        table = rich.table.Table(title=self.title)
        for name in shown:
            table.add_column(name, justify="left" if name == "name" else "right")
        for record in records:
            table.add_row(*(_text(name, record) for name in shown))
        return table

    def records(self) -> list[dict[str, float | int | str]]:
        """One dict a row, without what was not measured; a `Timing` becomes `seconds` and `spread`."""
        records = []
        for row in self.rows:
            record: dict[str, Any] = {"name": row.name, "error": row.error, "seconds": row.seconds}
            if isinstance(row.seconds, Timing):
                record |= {"seconds": row.seconds.median, "spread": row.seconds.spread}
            record |= {"bytes": row.bytes, **row.extra}
            records.append({name: value for name, value in record.items() if value is not None})
        return records

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Comma-separated, a heading line, empty where not measured. Raises InputError if it cannot be written."""
        records = self.records()
        with atomic(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, _headings(records))
            writer.writeheader()
            writer.writerows(records)

    def to_markdown(self, path: str | os.PathLike[str]) -> None:
        """The title and the table as it is printed, for documents. Raises InputError if it cannot be written."""
        records = self.records()
        shown = [name for name in _headings(records) if name != "spread"]
        rows = [shown, ["---" if name == "name" else "---:" for name in shown]]
        rows += [[_text(name, record) for name in shown] for record in records]
        # A stroke would end its cell.
        lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
        with atomic(path) as temporary:
            Path(temporary).write_text("\n".join([f"{self.title}", "", *lines, ""]), encoding="utf-8")

    def to_json(self, path: str | os.PathLike[str]) -> None:
        """`{"title": ..., "rows": [{...}, ...]}`. Raises InputError if it cannot be written."""
        with atomic(path) as temporary:
            Path(temporary).write_text(json.dumps({"title": self.title, "rows": self.records()}, indent=1))


def _headings(records: list[dict[str, Any]]) -> list[str]:
    first = ["name", "error", "seconds", "spread", "bytes"]
    found = dict.fromkeys(name for record in records for name in record)
    return [name for name in first if name in found or name == "name"] + [n for n in found if n not in first]


def _text(name: str, record: Mapping[str, Any]) -> str:
    if name not in record:
        return ""
    value = record[name]
    if name == "seconds":
        text = _scaled(value, ((1.0, "s"), (1e-3, "ms"), (1e-6, "us"), (1e-9, "ns")))
        return text + (f" ± {100 * record['spread']:.0f} %" if "spread" in record else "")
    if name == "bytes":
        return _scaled(value, ((2.0**30, "GB"), (2.0**20, "MB"), (2.0**10, "kB"), (1.0, "B")))
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _scaled(value: float | int, units: tuple[tuple[float, str], ...]) -> str:
    factor, unit = next(((factor, unit) for factor, unit in units if abs(value) >= factor), units[-1])
    return f"{value / factor:.4g} {unit}"
