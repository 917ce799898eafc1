"""Which addresses a webhook may be sent to, checked on the very address that is connected to.

A tenant chooses the URL, the service stands inside a network: without this guard a webhook could be
made to speak to a neighbour, or to a cloud's metadata service, in the service's name.
"""

from __future__ import annotations

import asyncio
import re
import socket
from collections.abc import Awaitable, Callable, Iterable
from concurrent.futures import Executor
from ipaddress import IPv4Address, IPv4Network, IPv6Address, IPv6Network, ip_address
from typing import Final

import httpcore
import httpx

from service.errors import ServiceError

Resolve = Callable[[str, int], Awaitable[list[str]]]
"""From host and port to numeric addresses, in the order in which they are to be tried."""

_HOST: Final = re.compile(rb"[A-Za-z0-9._-]+|[0-9A-Fa-f:.]+")
"""A name, after IDNA, or a numeric address."""

LOWEST_FREE_PORT: Final = 1024
"""Ports below it belong to system services (RFC 6335); of those only 443 takes webhooks."""

# IANA IPv4 Special-Purpose Address Registry (RFC 6890 and updates), what is not globally reachable.
_REFUSED_V4: Final = tuple(
    (IPv4Network(network), reason)
    for network, reason in (
        ("0.0.0.0/8", "this network"),
        ("10.0.0.0/8", "private"),
        ("100.64.0.0/10", "shared by carriers (CGNAT)"),
        ("127.0.0.0/8", "loopback"),
        ("168.63.129.16/32", "a cloud platform's own service"),
        ("169.254.0.0/16", "link-local"),
        ("172.16.0.0/12", "private"),
        ("192.0.0.0/24", "reserved for protocols"),
        ("192.0.2.0/24", "for documentation"),
        ("192.88.99.0/24", "a 6to4 relay"),
        ("192.168.0.0/16", "private"),
        ("198.18.0.0/15", "for benchmarks"),
        ("198.51.100.0/24", "for documentation"),
        ("203.0.113.0/24", "for documentation"),
        ("224.0.0.0/4", "multicast"),
        ("240.0.0.0/4", "reserved or broadcast"),
    )
)

# IPv6 is the other way round: only global unicast is let through, less what IANA's registry takes out of it.
_GLOBAL_V6: Final = IPv6Network("2000::/3")
_REFUSED_V6: Final = tuple(
    (IPv6Network(network), reason)
    for network, reason in (
        ("2001::/23", "reserved for protocols (Teredo, ORCHID)"),
        ("2001:db8::/32", "for documentation"),
        ("2002::/16", "6to4, which can hide any IPv4 address"),
        ("3fff::/20", "for documentation"),
    )
)
_MAPPED_V4: Final = IPv6Network("::ffff:0:0/96")
_NAT64: Final = IPv6Network("64:ff9b::/96")


class TargetError(ServiceError):
    """A webhook's URL or the address behind it cannot be sent to."""

    code = "webhook_target_refused"
    status = 422


def refusal(address: str) -> str | None:
    """Why a numeric address is not a public one, or None where it is."""
    numeric = ip_address(address.partition("%")[0])
    if isinstance(numeric, IPv6Address):
        if numeric in _MAPPED_V4 or numeric in _NAT64:
            # Both are ways to write an IPv4 address, and lead where it leads.
            return refusal(str(IPv4Address(int(numeric) & 0xFFFF_FFFF)))
        if numeric not in _GLOBAL_V6:
            return "not a global unicast address"
        return next((reason for network, reason in _REFUSED_V6 if numeric in network), None)
    return next((reason for network, reason in _REFUSED_V4 if numeric in network), None)


def check_url(text: str, *, allow_private: bool) -> httpx.URL:
    """The URL, parsed, if it may be registered; names are looked up only when something is sent.

    Plain http would carry accidents and places readable by everyone on the way: it is taken, like
    system ports, only together with private targets, which is for development.
    """
    try:
        url = httpx.URL(text)
        host = url.host  # decodes IDNA, which can fail
    except (httpx.InvalidURL, ValueError) as error:
        raise TargetError(f"the webhook URL cannot be read: {error}") from None
    schemes = ("https", "http") if allow_private else ("https",)
    if url.scheme not in schemes:
        raise TargetError(f"a webhook URL starts with {' or '.join(s + '://' for s in schemes)}, not {url.scheme!r}")
    if not _HOST.fullmatch(url.raw_host):
        raise TargetError(f"the webhook URL names no usable host ({host!r}), as in https://example.com/hooks")
    if url.userinfo:
        raise TargetError("the webhook URL carries a user or password; receivers verify the signature instead")
    if url.port is not None and not 0 < url.port < 65536:
        raise TargetError(f"the webhook URL names port {url.port}; ports are 1 to 65535")
    if allow_private:
        return url
    if url.port is not None and url.port != 443 and url.port < LOWEST_FREE_PORT:
        raise TargetError(f"webhooks are not sent to port {url.port}; use 443 or one from {LOWEST_FREE_PORT} up")
    try:
        reason = refusal(host)
    except ValueError:
        return url
    if reason:
        raise TargetError(f"webhooks are not sent to {host}: {reason}")
    return url


def system_resolver(executor: Executor) -> Resolve:
    """The system's name lookup on threads of its own: a dead name server must not take anybody else's."""

    async def resolve(host: str, port: int) -> list[str]:
        found = await asyncio.get_running_loop().run_in_executor(
            executor, lambda: socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        )
        return list(dict.fromkeys(str(entry[4][0]) for entry in found))

    return resolve


class GuardedBackend(httpcore.AsyncNetworkBackend):
    """TCP connections to checked addresses only.

    The name is resolved once and the connection goes to an address out of that very answer, so a name
    that answers differently a moment later (DNS rebinding) gains nothing; the TLS server name and the
    Host header remain the name's. One refused address in the answer refuses the name.
    """

    def __init__(self, resolve: Resolve, *, allow_private: bool) -> None:
        self._resolve = resolve
        self._allow_private = allow_private
        self._connect = httpcore.AnyIOBackend()

    async def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,
        local_address: str | None = None,
        socket_options: Iterable[httpcore.SOCKET_OPTION] | None = None,
    ) -> httpcore.AsyncNetworkStream:
        """Connect to the first address of ``host`` that answers."""
        try:
            addresses = await self._resolve(host, port)
        except OSError as error:
            raise httpcore.ConnectError(f"{host} cannot be resolved: {error}") from error
        if not addresses:
            raise httpcore.ConnectError(f"{host} has no address")
        if not self._allow_private:
            for address in addresses:
                if reason := refusal(address):
                    raise TargetError(f"webhooks are not sent to {host}, which is at {address}: {reason}")
        for address in addresses[:-1]:
            try:
                return await self._connect.connect_tcp(address, port, timeout, local_address, socket_options)
            except (httpcore.ConnectError, httpcore.ConnectTimeout):
                continue
        return await self._connect.connect_tcp(addresses[-1], port, timeout, local_address, socket_options)
