"""The redirects of the permanent IRIs, as executed by Apache, which serves w3id.org."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import closing
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import urlsplit

import httpx
import pytest

from rosld.ontology.modules import MODULES, VERSION, home_of_terms, module_iri, module_url
from tests import waiting
from tests.interop.missing import missing
from tests.server.auth.test_proxy import free_port
from tests.server.conftest import Served, start

RULES = Path(__file__).parents[3] / "ontology" / "w3id" / ".htaccess"
APACHE, APACHE_MODULES = "/usr/sbin/apache2", Path("/usr/lib/apache2/modules")
CONFIGURATION = """
ServerName localhost
ServerRoot {folder}
PidFile {folder}/pid
ErrorLog {folder}/log
Listen 127.0.0.1:{port}
{modules}
{user}
DocumentRoot {folder}/web
<Directory {folder}/web>
    AllowOverride All
    Require all granted
</Directory>
"""


@pytest.fixture(scope="module")
def robot() -> Iterator[Served]:
    """The public server that the redirects lead to."""
    served = start("aircraft")
    yield served
    served.stop()


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    """A folder that Apache can read even if root runs the tests."""
    with TemporaryDirectory() as path:
        Path(path).chmod(0o755)
        yield Path(path)


@pytest.fixture(scope="module")
def permanent(robot: Served, folder: Path) -> Iterator[str]:
    """The URL that stands for https://w3id.org/ here."""
    if shutil.which(APACHE) is None:
        missing("there is no Apache: apt-get install --no-install-recommends apache2-bin")
    port = free_port()
    (folder / "web" / "rosld").mkdir(parents=True)
    rules = RULES.read_text().replace("https://rosld.example.org/", robot.url)
    assert robot.url in rules
    (folder / "web" / "rosld" / ".htaccess").write_text(rules)
    names = ("mpm_event", "authz_core", "rewrite", "setenvif", "dir")
    modules = "\n".join(f"LoadModule {name}_module {APACHE_MODULES}/mod_{name}.so" for name in names)
    user = "User nobody\nGroup nogroup" if os.geteuid() == 0 else ""
    (folder / "conf").write_text(CONFIGURATION.format(folder=folder, port=port, modules=modules, user=user))
    running = subprocess.Popen([APACHE, "-f", folder / "conf", "-DFOREGROUND"])
    url = f"http://127.0.0.1:{port}/"
    with closing(httpx.Client()) as http:
        waiting.until(lambda: _answers(http, url), "Apache")
    yield url
    running.terminate()
    running.wait(60)


def _answers(http: httpx.Client, url: str) -> bool:
    try:
        return http.get(url).status_code > 0
    except httpx.TransportError:
        return False


def follow(permanent: str, iri: str, accept: str = "text/turtle") -> httpx.Response:
    url = permanent + urlsplit(iri).path.lstrip("/")
    return httpx.get(url, headers={"Accept": accept}, follow_redirects=True, timeout=60)


def test_every_module_and_every_version_of_it_is_where_its_iri_leads(permanent: str, robot: Served) -> None:
    for name, version in product(MODULES, ("", VERSION)):
        answer = follow(permanent, module_iri(name, version))
        assert (answer.status_code, str(answer.url)) == (200, module_url(name, robot.url))
        assert answer.history[-1].status_code == 303


def test_every_term_is_told_of_where_its_iri_leads(permanent: str) -> None:
    documents = {iri.partition("#")[0] for iri in home_of_terms()}
    told = {document: follow(permanent, document, "application/n-triples").text for document in documents}
    for iri in home_of_terms():
        assert f"\n<{iri}> " in f"\n{told[iri.partition('#')[0]]}", iri


@pytest.mark.parametrize("name", ["std_msgs/msg/Float64", "std_srvs/srv/Trigger", "rosld_aircraft/action/Fly"])
def test_types_lead_to_their_descriptions_whatever_their_packages(permanent: str, robot: Served, name: str) -> None:
    answer = follow(permanent, f"https://w3id.org/rosld/types/{name}")
    assert (answer.status_code, str(answer.url)) == (200, f"{robot.url}types/{name}")


@pytest.mark.parametrize("path", ["none", "0.2", "types/std_msgs", "types/a/b/c/d", "ontology"])
def test_what_is_no_iri_of_rosld_is_not_found(permanent: str, path: str) -> None:
    assert follow(permanent, f"https://w3id.org/rosld/{path}").status_code == 404
