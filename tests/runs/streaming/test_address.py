"""Where a stream may go."""

import socket
from contextlib import closing

import pytest

from modsim3d.core.errors import ModsimError
from modsim3d.runs.streaming.lines import Address

INCOMPLETE = ("", "127.0.0.1", ":5000", "127.0.0.1:", "127.0.0.1:-1", "127.0.0.1:5000/", "::1:5000", "127.0.0.1:٥٠٠٠")


def test_an_address_is_read_and_written() -> None:
    for text, address, loopback in (
        ("tcp://127.0.0.1:5000", Address("127.0.0.1", 5000), True),
        ("tcp://localhost:0", Address("127.0.0.1", 0), True),
        ("tcp://[::1]:5000", Address("::1", 5000), True),
        ("tcp://0.0.0.0:65535", Address("0.0.0.0", 65535), False),
        ("tcp://[::]:1", Address("::", 1), False),
    ):
        assert Address.parse(text) == address and address.loopback is loopback, text
        assert str(address) == text.replace("localhost", "127.0.0.1")


@pytest.mark.parametrize(("text", "part"), [
    ("lines.jsonl", "is neither - (standard output) nor tcp://ADDRESS:PORT"),
    *((text, "is neither -") for text in ("udp://127.0.0.1:5000", "")),
    *((f"tcp://{text}", "an address and a port are needed") for text in INCOMPLETE),
    ("tcp://127.0.0.1:65536", "a port is a number from 0 to 65535 (got 65536)"),
    ("tcp://example.org:5000", "'example.org' is no IP address"),
    ("tcp://[127.0.0.1]:5000", "'127.0.0.1' is no IP address"),
    *((f"tcp://{text}:5000", "is no IP address") for text in ("me@127.0.0.1", "127.0.0.256")),
])  # fmt: skip
def test_what_is_no_address_is_told(text: str, part: str) -> None:
    with pytest.raises(ModsimError) as caught:
        Address.parse(text)
    assert str(caught.value).startswith(f"--to '{text}': ") and part in str(caught.value)


def test_a_port_that_is_taken_and_an_address_of_another_computer_are_told() -> None:
    said = r"cannot listen there: .*; port 0 takes any free port"
    with closing(Address("127.0.0.1", 0).listen(4096)) as taken, pytest.raises(ModsimError, match=said):
        Address("127.0.0.1", taken.getsockname()[1]).listen(4096)
    with pytest.raises(ModsimError, match=r"--to tcp://192\.0\.2\.1:5000: cannot listen there"):
        Address("192.0.2.1", 5000).listen(4096)


def test_ipv6_listens_where_there_is_some() -> None:
    address = Address.parse("tcp://[::1]:0")
    try:
        with socket.socket(socket.AF_INET6) as probe:
            probe.bind(("::1", 0))
    except OSError:
        with pytest.raises(ModsimError, match="cannot listen there"):
            address.listen(4096)
        return
    with closing(address.listen(4096)) as listener:
        assert listener.getsockname()[0] == "::1"
