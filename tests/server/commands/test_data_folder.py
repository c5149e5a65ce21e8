"""The folder of --data belongs to one base."""

from __future__ import annotations

from pathlib import Path

import pytest

from rosld.server.commands.data_folder import claim

BASE = "http://127.0.0.1:8080/"


def test_a_folder_is_made_and_remembers_its_base(tmp_path: Path) -> None:
    claim(tmp_path / "new" / "data", BASE)
    claim(tmp_path / "new" / "data", BASE)
    assert [path.name for path in (tmp_path / "new" / "data").iterdir()] == ["base-url"]


def test_another_base_is_refused_and_told_the_owner(tmp_path: Path) -> None:
    claim(tmp_path, BASE)
    with pytest.raises(ValueError, match=f"--base-url {BASE}"):
        claim(tmp_path, "http://127.0.0.1:8081/")


def test_a_file_is_no_folder(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(OSError, match="exists"):
        claim(tmp_path / "file", BASE)
