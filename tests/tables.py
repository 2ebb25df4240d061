"""Rows that long tests leave for the tables in benchmarks/results/, see the fixture `record`."""

from __future__ import annotations

from collections.abc import Iterator


class Tables:
    """Rows by table. A row takes the place of an earlier one with the same keys, here and in the file."""

    def __init__(self) -> None:
        self.rows: dict[str, tuple[tuple[str, ...], list[dict]]] = {}

    def record(self, table: str, keys: tuple[str, ...], row: dict) -> None:
        """Keeps `row` and prints it, so that a long run (with -s) shows how it goes on."""
        self.rows.setdefault(table, (keys, []))[1].append(row)
        print("\n" + ", ".join(f"{name}: {value}" for name, value in row.items()), flush=True)

    def write(self) -> Iterator[tuple[str, str]]:
        """Puts them into the files. Gives names and the new rows as Markdown."""
        if not self.rows:
            return
        from benchmarks.common import update_table  # only here: most runs leave no rows

        for table, (keys, rows) in self.rows.items():
            yield table, update_table(table, keys, rows)
