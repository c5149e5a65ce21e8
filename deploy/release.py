"""Build and check a release (`make release`): sdist, wheel and SBOM in `dist/`, tried on each Python that is found.

It publishes and tags nothing; at the end it prints the commands that do.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from first_value import first_value

ROOT = Path(__file__).parent.parent
DIST = ROOT / "dist"
PYTHONS = ("3.10", "3.11", "3.12", "3.13", "3.14")
NEEDED = {"PKG-INFO", "LICENSE", "CHANGELOG.md", "Makefile", "tests", "server", "rosld", "deploy", "docs"}
UNWANTED = re.compile(r"\.hypothesis|__pycache__|\.venv|node_modules/|\.pyc$|\.crawl|\.mutants")


def main() -> None:
    version = _version()
    shutil.rmtree(DIST, ignore_errors=True)
    _run(sys.executable, "-m", "build", "--outdir", str(DIST), str(ROOT))
    (wheel,), (sdist,) = DIST.glob("*.whl"), DIST.glob("*.tar.gz")
    if wheel.name != f"rosld-{version}-py3-none-any.whl":
        sys.exit(f"{wheel.name} is not the wheel of version {version}.")
    _check_sdist(sdist)
    _run(sys.executable, "-m", "twine", "check", "--strict", str(wheel), str(sdist))
    with tempfile.TemporaryDirectory() as folder:
        tried = [name for name in PYTHONS if _try_python(name, wheel, Path(folder), DIST / f"rosld-{version}.cdx.json")]
    _try_tools(wheel)
    for name in PYTHONS:
        if name not in tried:
            print(f"Python {name}: not found, not tried")
    print(f"\nReady in {DIST}. To release:")
    print(f"    git tag --sign v{version} --message 'rosld {version}' && git push origin v{version}")


def _version() -> str:
    """Return the version, which must be that of the newest entry in the changelog."""
    match = re.search(r'__version__ = "(.+)"', (ROOT / "rosld" / "__init__.py").read_text("utf-8"))
    version = match[1] if match else ""
    entry = re.search(r"^## \[(.+?)\] - \d{4}-\d\d-\d\d$", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    if not entry or entry[1] != version:
        sys.exit(f"The newest dated entry of CHANGELOG.md is {entry and entry[1]}, not {version}.")
    return version


def _check_sdist(sdist: Path) -> None:
    with tarfile.open(sdist) as archive:
        names = [name.partition("/")[2] for name in archive.getnames()]
    missing = NEEDED - {name.partition("/")[0] for name in names}
    unwanted = [name for name in names if UNWANTED.search(name)]
    if missing or unwanted:
        sys.exit(f"{sdist.name} lacks {sorted(missing)} and has {unwanted[:5]}: see MANIFEST.in")


def _try_python(name: str, wheel: Path, folder: Path, sbom: Path) -> bool:
    """Install the wheel without a compiler in a new venv of this Python, and serve; the first one makes the SBOM."""
    python = next(_pythons(name), None)
    if python is None:
        return False
    begin = time.monotonic()
    venv = folder / name
    _run(python, "-m", "venv", str(venv))
    _run(str(venv / "bin" / "python"), "-m", "pip", "install", "--quiet", "--only-binary=:all:", str(wheel))
    installed = time.monotonic() - begin
    if not sbom.exists():
        scanned = ("cyclonedx_py", "environment", "--pyproject", str(ROOT / "pyproject.toml"))
        _run(
            sys.executable,
            "-m",
            *scanned,
            "--output-reproducible",
            "--output-file",
            str(sbom),
            str(venv / "bin" / "python"),
        )
    seconds = first_value([str(venv / "bin" / "rosld"), "serve", "aircraft", "--port", "0"])
    print(f"Python {name}: installed in {installed:.1f} s, first value after another {seconds:.1f} s")
    return True


def _pythons(name: str) -> Iterator[str]:
    """Yield the interpreters of a version: on the path, of pyenv and of uv."""
    candidates = [shutil.which(f"python{name}")]
    candidates += [str(path) for path in (Path.home() / ".pyenv" / "versions").glob(f"{name}.*/bin/python")]
    if uv := shutil.which("uv", path=_path()):
        found = subprocess.run(
            [uv, "python", "find", "--no-project", name], capture_output=True, text=True, check=False
        )
        candidates.append(found.stdout.strip() or None)
    code = "import sys, venv, ensurepip; print('%d.%d' % sys.version_info[:2])"
    for candidate in candidates:
        if candidate:
            done = subprocess.run([candidate, "-c", code], capture_output=True, text=True, check=False)
            if done.stdout.strip() == name:
                yield candidate


def _try_tools(wheel: Path) -> None:
    """Run the wheel with uvx and install it with pipx, both into empty folders."""
    with tempfile.TemporaryDirectory() as folder:
        env = {
            **os.environ,
            "UV_CACHE_DIR": f"{folder}/uv",
            "PIPX_HOME": f"{folder}/pipx",
            "PIPX_BIN_DIR": f"{folder}/bin",
        }
        if uvx := shutil.which("uvx", path=_path()):
            command = [
                uvx,
                "--python",
                sys.executable,
                "--from",
                str(wheel),
                "rosld",
                "serve",
                "aircraft",
                "--port",
                "0",
            ]
            print(f"uvx: first value after {first_value(command, env=env):.1f} s")
            print(f"uvx again: first value after {first_value(command, env=env):.1f} s")
        begin = time.monotonic()
        _run(sys.executable, "-m", "pipx", "install", "--python", sys.executable, str(wheel), env=env)
        installed = time.monotonic() - begin
        seconds = first_value([f"{folder}/bin/rosld", "serve", "aircraft", "--port", "0"])
        print(f"pipx: installed in {installed:.1f} s, first value after another {seconds:.1f} s")


def _path() -> str:
    return os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])


def _run(*command: str, env: dict[str, str] | None = None) -> None:
    if done := subprocess.run(command, env=env, check=False).returncode:
        sys.exit(f"{' '.join(command)} failed with status {done}.")


if __name__ == "__main__":
    main()
