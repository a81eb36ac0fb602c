"""Access to the window: requests of this machine with the token; changes only from pages of the window."""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Mapping
from http.cookies import CookieError, SimpleCookie

from msgspec import Struct


class Access(Struct, frozen=True):
    """Access to the window: its port and its secret.

    :param port: port on 127.0.0.1.
    :param token: secret in the address that is opened first, afterwards in a cookie.
    """

    port: int
    token: str

    @classmethod
    def for_port(cls, port: int) -> Access:
        """Return the access to a window on a port, with a new random token."""
        return cls(port, secrets.token_urlsafe(32))

    @property
    def hosts(self) -> tuple[str, str]:
        """Hosts with port that requests may name.

        Other names are refused, as they may be of another site (DNS rebinding).
        """
        return (f"127.0.0.1:{self.port}", f"localhost:{self.port}")

    @property
    def cookie_name(self) -> str:
        """Name of the cookie; it contains the port, as browsers send a cookie to all ports of a machine."""
        return f"postproc-{self.port}"

    @property
    def cookie(self) -> str:
        """Value of the header that sets the cookie: not for scripts, and not sent with requests from other sites."""
        return f"{self.cookie_name}={self.token}; HttpOnly; SameSite=Strict; Path=/"

    @property
    def address(self) -> str:
        """Address to open first, with the token."""
        return f"http://{self.hosts[0]}/?token={self.token}"

    def is_token(self, text: str) -> bool:
        """Return whether a text is the token; the time of the comparison does not depend on the text."""
        return hmac.compare_digest(text.encode(errors="replace"), self.token.encode())

    def refusal(self, headers: Mapping[str, str], *, is_change: bool, token: str = "") -> str:
        """Return the reason to refuse a request; empty if the request may be answered.

        It needs the token in its cookie. A request that changes nothing may have the token in its address instead; a
        request that changes something must come from a page of the window.

        :param headers: headers of the request.
        :param is_change: the request changes something.
        :param token: token in the address; empty: none.
        """
        host = headers.get("Host") or ""
        if host not in self.hosts:
            return "this address is not one of the window"
        if is_change and headers.get("Origin") != f"http://{host}":
            return "another page asked for this change"
        try:
            cookie = SimpleCookie(headers.get("Cookie") or "").get(self.cookie_name)
        except CookieError:
            cookie = None
        if cookie is not None and self.is_token(cookie.value):
            return ""
        return "" if token and not is_change and self.is_token(token) else "open the address that postproc app printed"
