"""Compiled code never outlives the sources it was made from."""

from __future__ import annotations

import os
from pathlib import Path

from service import compile_cache


def chosen(core: Path, monkeypatch) -> Path:
    monkeypatch.delenv(compile_cache.VARIABLE, raising=False)
    compile_cache.choose(core)
    return Path(os.environ[compile_cache.VARIABLE])


def test_a_changed_source_anywhere_gets_a_new_folder_and_the_old_one_goes(tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "navigation").mkdir()
    source = tmp_path / "navigation" / "state.py"
    source.write_text("N = 1\n")
    first = chosen(tmp_path, monkeypatch)
    (first / "kernel.nbc").write_bytes(b"compiled")
    assert chosen(tmp_path, monkeypatch) == first
    source.write_text("N = 2\n")
    second = chosen(tmp_path, monkeypatch)
    assert second != first
    assert second.is_dir()
    assert not first.exists()


def test_what_the_environment_says_is_kept(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv(compile_cache.VARIABLE, "/elsewhere")
    compile_cache.choose(tmp_path)
    assert os.environ[compile_cache.VARIABLE] == "/elsewhere"
    assert not (tmp_path / "__pycache__").exists()


def test_numba_keeps_the_cores_code_there() -> None:
    from core.navigation import kernel

    assert kernel.run.stats.cache_path.startswith(os.environ[compile_cache.VARIABLE])
