"""Local servers answer this machine only."""

import http.client
import socket
import threading
from email.message import Message

import pytest

from knowarm.asking.page import make_server
from knowarm.errors import UserError
from knowarm.local_server import PORTS, listen, refusal


def headers(**values):
    message = Message()
    for name, value in values.items():
        message[name] = value
    return message


@pytest.mark.parametrize(
    "host", ["localhost:8080", "127.0.0.1:8080", "LocalHost", "[::1]:90"]
)
def test_names_of_this_machine_are_answered(host):
    assert refusal("/", headers(Host=host)) is None
    assert (
        refusal("/", headers(Host=host, **{"Sec-Fetch-Site": "none"})) is None
    )  # typed
    assert refusal("/state", headers(Host=host, Origin=f"http://{host}")) is None
    for accepted in ("*/*", "text/html,image/webp,*/*;q=0.8", "application/json"):
        assert refusal("/", headers(Host=host, Accept=accepted)) is None


@pytest.mark.parametrize(
    ("path", "values"),
    [
        ("/", {"Host": "evil.example:8080"}),  # DNS rebinding
        ("/", {"Host": "localhost.evil.example:8080"}),
        ("/", {}),
        ("/state", {"Host": "localhost:8080", "Origin": "http://evil.example"}),
        ("/state", {"Host": "localhost:8080", "Origin": "null"}),
        ("/ui", {"Host": "localhost:8080", "Origin": "http://localhost:3000"}),
        # An image
        (
            "/?q=usedFor",
            {"Host": "localhost:8080", "Sec-Fetch-Site": "cross-site"},
        ),
        ("/", {"Host": "localhost:8080", "Sec-Fetch-Site": "same-site"}),
        ("/?q=mug", {"Host": "localhost:8080", "Accept": "image/avif,image/webp,*/*"}),
        ("/?q=mug", {"Host": "localhost:8080", "Accept": "image/png,image/*;q=0.8"}),
        ("/?q=mug", {"Host": "localhost:8080", "Accept": "IMAGE/PNG"}),
        ("/", {"Host": "[::1"}),
        ("/", {"Host": "evil.example@localhost:8080"}),
        ("/", {"Host": "localhost/evil.example"}),
        ("/", {"Host": "localhost#.evil.example"}),
        ("/", {"Host": "localhost?.evil.example"}),
        ("//[", {"Host": "localhost:8080"}),
    ],
)
def test_other_requests_are_refused(path, values):
    assert refusal(path, headers(**values)) is not None


def test_a_port_that_is_taken_is_named():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(UserError, match=f"Cannot listen on 127.0.0.1, port {port}"):
            listen([port])


def test_without_a_port_the_first_free_one_is_taken():
    with listen(PORTS) as first, listen(PORTS) as second:
        address, port = second.getsockname()
        assert address == "127.0.0.1"
        assert port in PORTS
        assert port > first.getsockname()[1]


def test_every_answer_forbids_frames_scripts_and_guesses_of_its_type():
    """Also those of errors; the page of questions is made by the same handler."""
    server = make_server(None, "")
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=60)
    for path, status in (("/other", 404), ("/?q=x", 403)):
        wrong = {"Origin": "http://evil.example"} if status == 403 else {}
        connection.request("GET", path, headers=wrong)
        response = connection.getresponse()
        assert response.status == status
        policy = response.headers["Content-Security-Policy"]
        assert "default-src 'none'" in policy
        assert "frame-ancestors 'none'" in policy
        assert "script" not in policy
        assert response.headers["X-Frame-Options"] == "DENY"
        assert response.headers["X-Content-Type-Options"] == "nosniff"
        response.read()
        connection.close()
    server.shutdown()
    thread.join()
    server.server_close()
