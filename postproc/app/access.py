"""Which requests are answered: of this machine, with the token, and changes only from the window's own pages."""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Mapping
from http.cookies import CookieError, SimpleCookie

from msgspec import Struct


class Access(Struct, frozen=True):
    """Who may use the window.

    :param port: on 127.0.0.1.
    :param token: in the address that is opened first, afterwards in a cookie.
    """

    port: int
    token: str

    @classmethod
    def at(cls, port: int) -> Access:
        """Return access by a new random token."""
        return cls(port, secrets.token_urlsafe(32))

    @property
    def hosts(self) -> tuple[str, str]:
        """Host names with port that browsers may use, by address and by name; others are refused (DNS rebinding)."""
        return (f"127.0.0.1:{self.port}", f"localhost:{self.port}")

    @property
    def cookie_name(self) -> str:
        """Name of the cookie: browsers send cookies to all ports of a machine."""
        return f"postproc-{self.port}"

    @property
    def cookie(self) -> str:
        """The header that sets the cookie; other sites and scripts do not get it."""
        return f"{self.cookie_name}={self.token}; HttpOnly; SameSite=Strict; Path=/"

    @property
    def address(self) -> str:
        """The address to open first."""
        return f"http://{self.hosts[0]}/?token={self.token}"

    def is_token(self, text: str) -> bool:
        """Return whether a text is the token, in a time that does not depend on the text."""
        return hmac.compare_digest(text.encode(errors="replace"), self.token.encode())

    def refusal(self, headers: Mapping[str, str], *, changes: bool, token: str = "") -> str:
        """Return the reason to refuse a request; empty if it is answered.

        :param changes: it changes something: then it must come from a page of the window.
        :param token: of the address; a request that changes something needs the cookie.
        """
        host = headers.get("Host") or ""
        if host not in self.hosts:
            return "this address is not one of the window"
        if changes and headers.get("Origin") != f"http://{host}":
            return "another page asked for this change"
        try:
            cookie = SimpleCookie(headers.get("Cookie") or "").get(self.cookie_name)
        except CookieError:
            cookie = None
        if cookie is not None and self.is_token(cookie.value):
            return ""
        return "" if token and not changes and self.is_token(token) else "open the address that postproc app printed"
