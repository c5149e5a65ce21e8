"""The files in `deploy/`, judged by systemd, Kubernetes' and Compose's schemas; wheels of all dependencies, by uv."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from tests.interop.missing import require

ROOT = Path(__file__).parent.parent.parent
DEPLOY = ROOT / "deploy"
COMPOSE = "github.com/compose-spec/compose-go/v2@v2.16.2"
PATH = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
"""With the commands of Python packages: uv and Go are such."""


def run(*command: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PATH": PATH, "UV_PYTHON_DOWNLOADS": "never"}
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)


def test_systemd_accepts_the_unit_and_rates_its_exposure_at_most_two() -> None:
    require("systemd-analyze")
    unit = str(DEPLOY / "rosld.service")
    complaints = run("systemd-analyze", "verify", unit).stderr.splitlines()
    assert [line for line in complaints if "rosld-ros is not executable" not in line] == []
    rated = run("systemd-analyze", "security", "--offline=true", "--threshold=20", unit)
    assert rated.returncode == 0, rated.stdout[-200:]


def test_the_manifest_fits_the_schemas_of_kubernetes() -> None:
    yaml = pytest.importorskip("ruamel.yaml").YAML(typ="safe")
    validate = pytest.importorskip("kubernetes_validate").validate
    documents = list(yaml.load_all(DEPLOY / "kubernetes.yml"))
    assert [each["kind"] for each in documents] == ["Secret", "PersistentVolumeClaim", "Deployment", "Service"]
    for each in documents:
        validate(each, "1.33", strict=True)


@pytest.fixture(scope="module")
def schema() -> Any:
    """The JSON schema with which Compose itself checks its files."""
    require("go", path=PATH)
    found = run("go", "mod", "download", "-json", COMPOSE)
    assert found.returncode == 0, found.stderr
    return json.loads((Path(json.loads(found.stdout)["Dir"]) / "schema" / "compose-spec.json").read_text("utf-8"))


@pytest.mark.parametrize("file", sorted((DEPLOY / "compose").iterdir()), ids=lambda file: file.stem)
def test_a_compose_file_fits_the_schema_of_compose_and_names_files_that_exist(file: Path, schema: Any) -> None:
    import jsonschema

    content = pytest.importorskip("ruamel.yaml").YAML(typ="safe").load(file)
    jsonschema.Draft202012Validator(schema).validate(content)
    for service in content["services"].values():
        mounts = [each.split(":")[0] for each in service.get("volumes", ()) if each.startswith(".")]
        assert all((file.parent / each).exists() for each in mounts), mounts


PLATFORMS = [("3.10", "aarch64"), ("3.14", "aarch64"), ("3.14", "x86_64")]
EXTRAS = ("oidc", "parquet", "mcp", "files", "otel")


@pytest.fixture(scope="module")
def resolutions() -> dict[tuple[str, str], subprocess.CompletedProcess[str]]:
    """Dependencies of rosld on each Python and machine, of wheels alone."""
    require("uv", path=PATH)
    extras = [f"--extra={extra}" for extra in EXTRAS]

    def resolve(platform: Sequence[str]) -> subprocess.CompletedProcess[str]:
        version, machine = platform
        where = (f"--python-version={version}", f"--python-platform={machine}-manylinux_2_28")
        return run("uv", "pip", "compile", "--only-binary=:all:", *where, *extras, str(ROOT / "pyproject.toml"))

    with ThreadPoolExecutor(len(PLATFORMS)) as pool:
        return dict(zip(PLATFORMS, pool.map(resolve, PLATFORMS), strict=True))


@pytest.mark.parametrize("platform", PLATFORMS, ids="-".join)
def test_every_dependency_has_a_wheel(platform: tuple[str, str], resolutions: Any) -> None:
    found = resolutions[platform]
    assert found.returncode == 0, found.stderr[-2000:]
    assert re.search(r"^numpy==", found.stdout, re.MULTILINE)
