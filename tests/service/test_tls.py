"""TLS: the service speaks it with a certificate, to clients that trust it, and to nobody in plain text."""

from __future__ import annotations

import ssl
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
import trustme

from robomend.cli.commands import run
from robomend_bench.service.process import NotReady, served


@pytest.fixture(scope="module")
def authority() -> trustme.CA:
    return trustme.CA()


@pytest.fixture(scope="module")
def options(authority: trustme.CA, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The service's options, with a certificate of 127.0.0.1 and its key."""
    folder = tmp_path_factory.mktemp("tls")
    issued = authority.issue_cert("127.0.0.1")
    certificate, key = folder / "certificate.pem", folder / "key.pem"
    issued.private_key_pem.write_to_path(key)
    for number, blob in enumerate(issued.cert_chain_pems):
        blob.write_to_path(certificate, append=number > 0)
    return ["--tls-certificate", str(certificate), "--tls-key", str(key)]


@pytest.fixture(scope="module")
def url(options: list[str]) -> Iterator[str]:
    with served(options) as service:
        yield service.url


def test_a_service_with_a_certificate_is_reached_over_tls_alone(url: str, authority: trustme.CA) -> None:
    trusting = ssl.create_default_context()
    authority.configure_trust(trusting)
    assert url.startswith("https://127.0.0.1:")
    assert httpx.get(f"{url}/healthz", verify=trusting, timeout=60).json() == {"status": "ok"}
    with pytest.raises(httpx.ConnectError):  # whoever does not know the authority does not talk to it
        httpx.get(f"{url}/healthz", timeout=60)
    with pytest.raises(httpx.HTTPError):
        httpx.get(f"{url}/healthz".replace("https:", "http:"), timeout=60)


def test_the_commands_say_what_tls_lacks_and_trust_whom_ssl_cert_file_names(
    url: str,
    authority: trustme.CA,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def status(url: str) -> tuple[int, str]:
        code = run(["status", "--url", url])
        return code, capsys.readouterr().err

    code, said = status(url)
    assert code == 3
    assert "its certificate is not trusted (" in said
    code, said = status(url.replace("https:", "http:"))
    assert code == 3
    assert "if it serves TLS, its address begins with https://" in said
    authority.cert_pem.write_to_path(tmp_path / "authority.pem")
    monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "authority.pem"))
    assert status(url)[0] == 0
    monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "none.pem"))
    code, said = status(url)
    assert code == 2
    assert f"SSL_CERT_FILE={tmp_path / 'none.pem'}: " in said


def test_the_doctor_knows_a_service_by_its_answer_over_tls(
    url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROBOMEND_PORT", url.rpartition(":")[2])
    run(["doctor", "--data", str(tmp_path)])
    assert "a service runs there, robomend" in capsys.readouterr().out.splitlines()[-1]


def test_a_certificate_without_its_key_is_refused(options: list[str]) -> None:
    with pytest.raises(NotReady, match="tls_certificate and tls_key go together"), served(options[:2]):
        pass
