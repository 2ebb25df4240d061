"""Rows that long tests leave: they join the table's file, each in its predecessor's place."""

from __future__ import annotations

from tables import Tables


def table_of(rows: list[dict]) -> Tables:
    tables = Tables()
    for row in rows:
        tables.record("t", ("case",), row)
    return tables


def test_a_part_of_the_run_keeps_the_other_rows(monkeypatch, tmp_path):
    monkeypatch.setattr("benchmarks.common.RESULTS", tmp_path)
    list(table_of([{"case": "b", "x": 1}, {"case": "a", "x": 2}]).write())
    written = list(table_of([{"case": "b", "x": 3}]).write())
    assert written == [("t", "| case | x |\n| --- | --- |\n| b | 3 |\n")]
    assert (tmp_path / "t.csv").read_text() == "case,x\na,2\nb,3\n"
    assert (tmp_path / "t.md").read_text().startswith("| case | x |\n| --- | --- |\n| a | 2 |\n| b | 3 |\n\n")


def test_without_rows_nothing_is_written(monkeypatch, tmp_path):
    monkeypatch.setattr("benchmarks.common.RESULTS", tmp_path / "none")
    assert list(Tables().write()) == []
    assert not (tmp_path / "none").exists()
