"""Where a stream goes: `-` is standard output, `tcp://ADDRESS:PORT` is a port that readers connect to."""

from __future__ import annotations

import ipaddress
import re
import socket
from dataclasses import dataclass

from modsim3d.errors import ModsimError

STANDARD_OUTPUT = "-"
_TCP = re.compile(r"tcp://(?:\[(?P<six>[^\[\]/]+)\]|(?P<four>[^\[\]/:]+)):(?P<port>[0-9]{1,5})")
_EXAMPLE = "tcp://127.0.0.1:5000, tcp://[::1]:5000, or port 0 for any free port"


@dataclass(frozen=True)
class Address:
    """An IP address of this computer and a port; 0 is any free port."""

    host: str
    port: int

    @classmethod
    def parse(cls, text: str) -> Address:
        """The address that `--to` names.

        Raises:
            ModsimError: It is none.
        """
        if not text.startswith("tcp://"):
            raise ModsimError(
                f"--to '{text}': is neither - (standard output) nor tcp://ADDRESS:PORT ({_EXAMPLE}); "
                "for a file use --to - > FILE"
            )
        found = _TCP.fullmatch(text)
        if found is None:
            raise ModsimError(f"--to '{text}': an address and a port are needed: {_EXAMPLE}")
        if (port := int(found["port"])) > 65535:
            raise ModsimError(f"--to '{text}': a port is a number from 0 to 65535 (got {port})")
        host = found["six"] or ("127.0.0.1" if found["four"] == "localhost" else found["four"])
        if not _is_ip(host, ipaddress.IPv6Address if found["six"] else ipaddress.IPv4Address):
            raise ModsimError(f"--to '{text}': '{host}' is no IP address of this computer: {_EXAMPLE}")
        return cls(host, port)

    def __str__(self) -> str:
        """As `--to` takes it."""
        return f"tcp://{f'[{self.host}]' if ':' in self.host else self.host}:{self.port}"

    @property
    def loopback(self) -> bool:
        """Whether only programs of this computer reach it."""
        return ipaddress.ip_address(self.host).is_loopback

    def listen(self, receive_bytes: int) -> socket.socket:
        """A socket that listens there and does not block; `receive_bytes` bounds what a connection takes in unread.

        Raises:
            ModsimError: The port is taken or may not be used, or this computer has no such address.
        """
        listener = None
        try:
            family, kind, protocol, _, place = socket.getaddrinfo(
                self.host, self.port, type=socket.SOCK_STREAM, flags=socket.AI_NUMERICHOST
            )[0]
            listener = socket.socket(family, kind, protocol)
            if hasattr(socket, "AF_UNIX"):  # Windows would let two programs listen on one port
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
            listener.setblocking(False)
            listener.bind(place)
            listener.listen()
        except OSError as error:
            if listener is not None:
                listener.close()
            raise ModsimError(
                f"--to {self}: cannot listen there: {error.strerror or error}; port 0 takes any free port"
            ) from None
        return listener


def _is_ip(host: str, kind: type[ipaddress.IPv4Address | ipaddress.IPv6Address]) -> bool:
    try:
        kind(host)
    except ValueError:
        return False
    return True
