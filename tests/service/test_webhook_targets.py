"""No webhook reaches what stands beside the service: the table of addresses, URLs, and rebinding names."""

from __future__ import annotations

import asyncio
import shutil
import ssl
import subprocess

import pytest

from service.webhooks.client import ClientLimits, WebhookClient
from service.webhooks.targets import TargetError, check_url, refusal
from tests.service.webhook_receiver import Answer, WebhookReceiver, closed_port

REFUSED = {
    "this network": ["0.0.0.0", "0.1.2.3", "::"],
    "private": [
        "10.0.0.1",
        "10.255.255.255",
        "172.16.0.1",
        "172.31.255.255",
        "192.168.0.1",
        "fc00::1",
        "fd00:ec2::254",
    ],
    "shared by carriers": ["100.64.0.1", "100.100.100.200", "100.127.255.255"],
    "loopback": ["127.0.0.1", "127.8.9.10", "::1"],
    "link-local": ["169.254.0.1", "169.254.169.254", "fe80::1", "fe80::1%eth0", "febf::1"],
    "site-local": ["fec0::1"],
    "protocols": ["192.0.0.8", "2001::1", "2001:0:7f00:1::1", "2001:10::1", "2001:20::1", "5f00::1"],
    "cloud platform": ["168.63.129.16"],
    "documentation": ["192.0.2.1", "198.51.100.7", "203.0.113.9", "2001:db8::1", "3fff::1"],
    "benchmarks": ["198.18.0.1", "198.19.255.255"],
    "multicast": ["224.0.0.1", "224.0.1.1", "239.255.255.255", "ff02::1", "ff0e::1"],
    "reserved": ["240.0.0.1", "255.255.255.255", "100::1"],
    "6to4": ["192.88.99.1", "2002:7f00:1::", "2002:808:808::1"],
    "IPv4 in IPv6": ["::ffff:127.0.0.1", "::ffff:10.0.0.1", "::ffff:169.254.169.254", "::127.0.0.1", "::a00:1"],
    "NAT64": ["64:ff9b::7f00:1", "64:ff9b::a9fe:a9fe", "64:ff9b:1::808:808"],
}
ALLOWED = {
    "public": [
        "1.1.1.1",
        "93.184.215.14",
        "2001:200::1",
        "2001:4860:4860::8888",
        "2606:4700:4700::1111",
        "2a00:1450::5",
    ],
    "just outside a refused block": [
        *("9.255.255.255", "11.0.0.0", "100.63.255.255", "100.128.0.0", "126.255.255.255", "128.0.0.1"),
        *("169.253.255.255", "172.15.255.255", "172.32.0.0", "192.0.1.1", "192.167.255.255", "198.17.255.255"),
        *("223.255.255.255", "2001:db7::1", "3ffe::1"),
    ],
    "public IPv4 in IPv6": ["::ffff:8.8.8.8", "64:ff9b::808:808"],
}


def rows(table):
    return [
        pytest.param(address, id=f"{kind}: {address}") for kind, addresses in table.items() for address in addresses
    ]


@pytest.mark.parametrize("address", rows(REFUSED))
def test_address_that_is_not_public_is_refused_with_a_reason(address):
    assert refusal(address)


@pytest.mark.parametrize("address", rows(ALLOWED))
def test_public_address_is_let_through(address):
    assert refusal(address) is None


@pytest.mark.parametrize(
    "url",
    [
        "https://example.com",
        "https://example.com/hooks?key=1",
        "https://example.com:8443/",
        "https://example.com:443/",
        "https://münchen.example/",
        "https://8.8.8.8/",
        "https://[2606:4700:4700::1111]:8443/x",
    ],
)
def test_public_https_url_can_be_registered(url):
    assert check_url(url, allow_private=False)


@pytest.mark.parametrize(
    "url",
    [
        "http://example.com/",
        "ftp://example.com/",
        "file:///etc/passwd",
        "example.com/hook",
        "//example.com/hook",
        "https:///hook",
        "https://",
        "https://user@example.com/",
        "https://user:password@example.com/",
        "https://example.com:22/",
        "https://example.com:80/",
        "https://example.com:0/",
        "https://example.com:65536/",
        "https://exam ple.com/",
        "https://example.com\r\nHost: inside/",
        "https://[::1/",
        "https://xn--/",
        "https://127.0.0.1/",
        "https://169.254.169.254/latest/meta-data/",
        "https://[::1]:8443/",
        "https://[::ffff:10.0.0.1]/",
        "",
    ],
)
def test_url_that_cannot_be_a_receiver_is_refused(url):
    with pytest.raises(TargetError):
        check_url(url, allow_private=False)


@pytest.mark.parametrize(
    "url", ["http://127.0.0.1:8000/", "http://localhost/", "https://10.0.0.1:80/", "http://[::1]/"]
)
def test_the_dangerous_setting_lets_plain_and_private_targets_through(url):
    assert check_url(url, allow_private=True)


@pytest.mark.parametrize("url", ["ftp://10.0.0.1/", "http://user:pw@localhost/", "http://localhost:0/", "http:///x"])
def test_even_the_dangerous_setting_needs_a_url_that_makes_sense(url):
    with pytest.raises(TargetError):
        check_url(url, allow_private=True)


class Names:
    """A name server for tests: answers in turn, and remembers what it was asked."""

    def __init__(self, *answers):
        self.answers = list(answers)
        self.asked = []

    async def __call__(self, host, port):
        self.asked.append((host, port))
        return self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]


def post(url, *, resolve=None, allow_private=False, times=1, limits=None):
    async def send():
        client = WebhookClient(allow_private=allow_private, limits=limits or ClientLimits(total_s=5), resolve=resolve)
        try:
            return [await client.post(url, {"Webhook-Id": "x"}, b"{}", lambda: None) for _ in range(times)]
        finally:
            await client.aclose()

    return asyncio.run(send())


@pytest.mark.parametrize("answer", [["127.0.0.1"], ["10.0.0.7"], ["8.8.8.8", "127.0.0.1"], ["::ffff:127.0.0.1"]])
def test_name_that_leads_inside_is_refused_before_anything_is_connected(answer):
    with WebhookReceiver() as receiver:
        url = f"https://hooks.example:{receiver.port}/"
        (reply,) = post(url, resolve=Names(answer))
        assert reply.status_code is None
        assert reply.error.startswith("webhook_target_refused: webhooks are not sent to hooks.example")
        assert receiver.connections == 0


@pytest.mark.parametrize("host", ["127.1", "2130706433", "0x7f000001", "localhost"])
def test_other_spellings_of_loopback_are_refused_by_the_address_they_resolve_to(host):
    with WebhookReceiver() as receiver:
        (reply,) = post(f"https://{host}:{receiver.port}/")
        assert reply.status_code is None
        assert receiver.connections == 0


def test_the_checked_address_is_the_one_connected_to():
    """A name that answers with loopback only once the check is over (rebinding) is asked once."""
    names = Names(["192.0.2.1"], ["127.0.0.1"])
    with WebhookReceiver() as receiver:
        (reply,) = post(f"https://hooks.example:{receiver.port}/", resolve=names)
        assert "192.0.2.1" in reply.error
        assert len(names.asked) == 1
        assert receiver.connections == 0


def test_a_name_is_resolved_once_a_connection_and_the_next_address_is_tried():
    with WebhookReceiver() as receiver:
        # 127.0.0.2 is loopback as well, but nobody listens there.
        names = Names(["127.0.0.2", "127.0.0.1"])
        url = receiver.url(host="hooks.example")
        replies = post(url, resolve=names, allow_private=True, times=3)
        assert [reply.status_code for reply in replies] == [204] * 3
        assert names.asked == [("hooks.example", receiver.port)]
        assert {request.peer for request in receiver.requests} == {receiver.requests[0].peer}
        assert receiver.requests[0].headers["host"] == f"hooks.example:{receiver.port}"


def test_redirect_is_not_followed():
    with WebhookReceiver() as inside, WebhookReceiver() as receiver:
        receiver.default = Answer(307, {"Location": inside.url("/secret")})
        (reply,) = post(receiver.url(), allow_private=True)
        assert reply.status_code == 307
        assert inside.connections == 0


def test_proxy_of_the_environment_is_not_used(monkeypatch):
    with WebhookReceiver() as proxy, WebhookReceiver() as receiver:
        for name in ("http_proxy", "https_proxy", "all_proxy"):
            monkeypatch.setenv(name, proxy.url(""))
            monkeypatch.setenv(name.upper(), proxy.url(""))
        (reply,) = post(receiver.url(), allow_private=True)
        assert reply.status_code == 204
        assert proxy.connections == 0


@pytest.fixture
def certificate(tmp_path):
    if shutil.which("openssl") is None:  # no declared package makes certificates; git and Debian's images bring it
        pytest.skip("openssl is needed to make a certificate for this test")
    subject = "/CN=hooks.example"
    command = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    files = ["-keyout", str(tmp_path / "key.pem"), "-out", str(tmp_path / "certificate.pem")]
    names = ["-subj", subject, "-addext", "subjectAltName=DNS:hooks.example", "-days", "2"]
    subprocess.run([*command, *files, *names], check=True, capture_output=True)
    return tmp_path / "certificate.pem", tmp_path / "key.pem"


def tls_server(certificate):
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(*certificate)
    asked = []
    context.sni_callback = lambda _socket, name, _context: asked.append(name)
    return context, asked


def test_tls_is_verified_for_the_name_while_connected_to_the_address(certificate, monkeypatch):
    context, asked = tls_server(certificate)
    monkeypatch.setenv("SSL_CERT_FILE", str(certificate[0]))
    with WebhookReceiver(tls=context) as receiver:
        names = Names(["127.0.0.1"])
        (reply,) = post(receiver.url(host="hooks.example"), resolve=names, allow_private=True)
        assert reply.status_code == 204, reply.error
        assert asked == ["hooks.example"]
        (reply,) = post(receiver.url(host="other.example"), resolve=names, allow_private=True)
        assert reply.status_code is None
        assert "certificate" in reply.error.lower()


def test_untrusted_certificate_is_a_failure(certificate):
    context, _ = tls_server(certificate)
    with WebhookReceiver(tls=context) as receiver:
        (reply,) = post(receiver.url(host="hooks.example"), resolve=Names(["127.0.0.1"]), allow_private=True)
        assert reply.status_code is None
        assert "certificate" in reply.error.lower()
        assert receiver.requests == []


def test_unknown_name_and_closed_port_are_failures_with_a_reason():
    async def nowhere(host, port):
        raise OSError("Name or service not known")

    (reply,) = post("https://nowhere.example/", resolve=nowhere)
    assert "nowhere.example cannot be resolved" in reply.error
    (reply,) = post(f"http://127.0.0.1:{closed_port()}/", allow_private=True)
    assert reply.error.startswith("ConnectError")
