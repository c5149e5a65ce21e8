"""A small real OpenID Connect issuer on loopback."""

from __future__ import annotations

import json
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import jwt
from cryptography.hazmat.primitives.asymmetric import rsa


class Issuer:
    """An issuer: its URL, its key, and the number of times its keys were fetched."""

    def __init__(self) -> None:
        self.key = rsa.generate_private_key(public_exponent=65537, key_size=2048)
        self.other = rsa.generate_private_key(public_exponent=65537, key_size=2048)
        self.fetched = 0
        issuer = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                if self.path == "/keys":
                    issuer.fetched += 1
                    public = jwt.algorithms.RSAAlgorithm.to_jwk(issuer.key.public_key(), as_dict=True)
                    body: dict[str, Any] = {
                        "keys": [{**public, "kid": "one", "use": "sig"}, {"kty": "oct", "kid": "s", "k": "AA"}]
                    }
                else:
                    body = {"issuer": issuer.url, "jwks_uri": f"{issuer.url}/keys"}
                data = json.dumps(body).encode()
                self.send_response(200)
                self.send_header("Content-Length", str(len(data)))
                self.end_headers()
                self.wfile.write(data)

            def log_message(self, *_: object) -> None:
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_port}"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def token(self, key: object = None, algorithm: str = "RS256", kid: str | None = "one", **said: object) -> str:
        """Return a token that is valid, except for the given claims."""
        claims = {"iss": self.url, "aud": "robot", "sub": "anna-1", "exp": time.time() + 60, **said}
        headers = {} if kid is None else {"kid": kid}
        return jwt.encode(
            {name: value for name, value in claims.items() if value is not None},
            self.key if key is None else key,
            algorithm,
            headers,
        )  # type: ignore[arg-type]
