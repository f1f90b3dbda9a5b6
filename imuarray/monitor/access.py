"""Access control of the page: this machine or the holder of the token, and no request that another page makes a browser
send.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
from collections.abc import Mapping
from types import MappingProxyType

HEADERS: Mapping[str, str] = MappingProxyType(
    {
        "Content-Security-Policy": (
            "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:;"
            " connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        ),
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",  # the address holds the token
        "Cross-Origin-Opener-Policy": "same-origin",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Cache-Control": "no-store",
    }
)
"""Headers of every response. Bokeh styles what it draws in the page, hence 'unsafe-inline' for styles alone."""

_OWN_SITE = frozenset({"", "none", "same-origin"})
_TOKEN_BYTES = 24


def is_own(host: str) -> bool:
    """Return whether only this machine can reach an address."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == "localhost"


def new_token() -> str:
    """Return a new secret token that fits into a URL."""
    return secrets.token_urlsafe(_TOKEN_BYTES)


def refusal(token: str, given: str, host: str, headers: Mapping[str, str]) -> str | None:
    """Return why a request is refused; None: it is not. `token` "" is for pages that only this machine can reach: then
    `host`, the name under which it was asked for, has to be one of its own, or else a foreign name was made to lead
    here.
    """
    if headers.get("Sec-Fetch-Site", "") not in _OWN_SITE:
        return "requested by another page"
    origin = headers.get("Origin")
    if origin is not None and origin.split("://")[-1] != host:
        return "requested by another page"
    if token:
        given_right = hmac.compare_digest(given.encode(), token.encode())
        return None if given_right else "the token is missing or wrong: use the address that imuarray printed"
    name = host.rsplit(":", 1)[0] if not host.endswith("]") else host
    return None if is_own(name) else "requested under another host name: use http://127.0.0.1"
