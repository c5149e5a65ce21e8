"""TLS by the server itself: `--tls-cert` and `--tls-key`."""

from __future__ import annotations

import ssl
from pathlib import Path

import uvicorn


def require_certificate(certificate: Path, key: Path | None) -> None:
    """Raises ValueError with a sentence where a certificate cannot be served with."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        context.load_cert_chain(certificate, key, password=_no_password)
    except ssl.SSLError as error:
        where = f"--tls-cert {certificate}" + ("" if key is None else f", --tls-key {key}")
        words = (error.reason or str(error)).replace("_", " ").lower()
        raise ValueError(f"{where}: {words}: a certificate and its private key, both in PEM, are needed") from error


def configure_tls(config: uvicorn.Config, certificate: Path | None, key: Path | None) -> None:
    """Have a server speak TLS, if it has a certificate."""
    if certificate is not None:
        config.ssl_certfile = str(certificate)
        config.ssl_keyfile = None if key is None else str(key)


def _no_password() -> str:
    raise ValueError("the private key is encrypted: give it without a password, in a file that nobody else can read")
