"""The page's server: authorised requests, their headers, and requests after the last snapshot."""

from __future__ import annotations

import asyncio
import json
import re
import signal
import time
import urllib.error
import urllib.request
from pathlib import Path
from typing import NamedTuple

import pytest

from imuarray.cli import main
from imuarray.monitor.log_monitor import LogMonitor, SharedSnapshots
from imuarray.monitor.server import HEADERS, address_of, is_own, new_token, refusal
from tests.monitor.page_server import serve_page


class Answer(NamedTuple):
    status: int
    headers: dict[str, str]
    text: str


def asked(address: str, part: str = "", method: str = "GET", **headers: str) -> Answer:
    base, _, query = address.partition("?")
    url = f"{base}{part}" + (f"?{query}" if query else "")
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    try:
        answer = urllib.request.urlopen(urllib.request.Request(url, headers=named, method=method), timeout=60)  # noqa: S310
    except urllib.error.HTTPError as error:
        answer = error
    with answer:
        return Answer(answer.status, dict(answer.headers.items()), answer.read().decode())


@pytest.mark.parametrize(
    ("token", "given", "host", "headers", "refused"),
    [
        ("", "", "127.0.0.1:8765", {}, None),
        ("", "", "localhost:8765", {"Sec-Fetch-Site": "same-origin", "Origin": "http://localhost:8765"}, None),
        ("", "", "[::1]:8765", {"Sec-Fetch-Site": "none"}, None),
        ("", "", "[::1]", {}, None),
        ("", "", "127.0.0.2:8765", {}, None),  # no name, so that no DNS record can point here
        ("", "", "[::ffff:192.168.1.5]:8765", {}, "another host name"),
        ("", "", "evil.example:8765", {}, "another host name"),
        ("", "", "127.0.0.1.evil.example", {}, "another host name"),
        ("", "", "127.0.0.1:8765", {"Sec-Fetch-Site": "cross-site"}, "another page"),
        ("", "", "127.0.0.1:8765", {"Sec-Fetch-Site": "same-site"}, "another page"),
        ("", "", "127.0.0.1:8765", {"Origin": "http://evil.example"}, "another page"),
        ("", "", "127.0.0.1:8765", {"Origin": "null"}, "another page"),
        ("right", "right", "pi.local:8765", {}, None),
        ("right", "", "127.0.0.1:8765", {}, "token"),
        ("right", "wrong", "pi.local:8765", {}, "token"),
        ("right", "rightly", "pi.local:8765", {}, "token"),
        ("right", "rïght", "pi.local:8765", {}, "token"),
        ("right", "right", "pi.local:8765", {"Origin": "http://evil.example"}, "another page"),
    ],
)
def test_requests_are_served_or_refused_by_token_host_and_origin(
    token: str, given: str, host: str, headers: dict[str, str], refused: str | None
) -> None:
    why = refusal(token, given, host, headers)
    assert why is None if refused is None else why is not None and refused in why


@pytest.mark.parametrize(
    ("host", "own"),
    [("127.0.0.1", True), ("127.3.2.1", True), ("::1", True), ("localhost", True), ("0.0.0.0", False), ("::", False),  # noqa: S104
     ("192.168.1.5", False), ("raspberrypi", False), ("localhost.evil.example", False)],
)  # fmt: skip
def test_loopback_addresses_are_local(host: str, own: bool) -> None:
    assert is_own(host) == own


@pytest.mark.parametrize(
    ("host", "address"),
    [("127.0.0.1", "http://127.0.0.1:1/"), ("::1", "http://[::1]:1/"), ("[::1]", "http://[::1]:1/")],
)
def test_the_address_to_open_is_built_from_host_port_and_token(host: str, address: str) -> None:
    assert address_of(host, 1, "") == address
    assert address_of(host, 1, "t") == f"{address}?token=t"


def test_tokens_are_long_and_distinct() -> None:
    tokens = {new_token() for _ in range(100)}
    assert len(tokens) == 100
    assert all(re.fullmatch(r"[\w-]{32}", token) for token in tokens)


def awaited_rows(address: str, rows: int) -> int:
    """The rows of the first sensor, as soon as there are `rows` of them or after a minute."""
    until_s = time.monotonic() + 60
    while True:
        shown: int = json.loads(asked(address, "snapshot.json").text)["sensors"][0]["rows"]
        if shown >= rows or time.monotonic() > until_s:
            return shown
        time.sleep(0.05)


@pytest.mark.slow
def test_the_page_is_served_on_the_local_machine(logger, log_path: Path) -> None:  # type: ignore[no-untyped-def]
    logger.go_on(3.0)
    with serve_page(log_path) as (address, process):
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/", address)
        page = asked(address)
        assert page.status == 200
        assert {name: page.headers[name] for name in HEADERS} == dict(HEADERS)
        assert "Access-Control-Allow-Origin" not in page.headers
        assert "unsafe-eval" not in page.headers["Content-Security-Policy"]
        parts = re.findall(r'(?:src|href)="([^"]+)"', page.text)
        assert sorted(parts) == ["bokeh.min.js", "data:,", "page.css", "page.js"]  # no external resource
        assert [asked(address, part).status for part in ("page.css", "page.js", "bokeh.min.js")] == [200, 200, 200]
        first = json.loads(asked(address, "snapshot.json").text)
        assert (first["state"], [entry["name"] for entry in first["sensors"]]) == (
            "being written", ["Acc", "Turned", "Gyro", "Baro"],
        )  # fmt: skip
        figures = json.loads(asked(address, "figures.json").text)
        assert {"trace|x,y,z|g", "density|x,y,z|mg", "trace|pressure|hPa"} <= set(figures)
        logger.go_on(1.0)
        assert awaited_rows(address, 400) == 400
        with pytest.raises(urllib.error.URLError, match="refused"):  # no other address, not even another local address
            asked(address.replace("127.0.0.1", "127.0.0.2"))
        assert asked(address, "snapshot.json", Host="evil.example").status == 403
        assert asked(address, "snapshot.json", Origin="http://evil.example").status == 403
        assert asked(address, "snapshot.json", method="POST").status == 405
        heads = [asked(address, part, method="HEAD") for part in ("", "page.css", "snapshot.json", "figures.json")]
        assert [(head.status, head.text) for head in heads] == [(200, "")] * 4
        assert asked(address, "../pyproject.toml").status == 404
        assert asked(address, "page.html").status == 404
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
        assert process.stderr is not None and process.stderr.read() == ""


@pytest.mark.slow
def test_another_address_requires_the_token(logger, log_path: Path) -> None:  # type: ignore[no-untyped-def]
    logger.go_on(1.0)
    with serve_page(log_path, "--host", "0.0.0.0") as (printed, _):  # noqa: S104
        match = re.fullmatch(r"http://[^/]+:(\d+)/\?token=([\w-]{32})", printed)
        assert match is not None
        address = f"http://127.0.0.1:{match[1]}/"
        for part in ("", "page.js", "snapshot.json", "figures.json", "nothing"):
            assert asked(address, part).status == 403
            assert asked(f"{address}?token={match[2][:-1]}", part).status == 403
        page = asked(f"{address}?token={match[2]}")
        assert page.status == 200 and f"page.js?token={match[2]}" in page.text
        assert asked(f"{address}?token={match[2]}", "snapshot.json").status == 200


@pytest.mark.slow
def test_a_request_after_the_end_gets_the_last_snapshot(logger, log_path: Path) -> None:  # type: ignore[no-untyped-def]
    """The server ends while a page still asks: no error."""
    logger.go_on(1.0)

    async def ask() -> tuple[bytes, bytes, int]:
        snapshots = SharedSnapshots(LogMonitor(log_path), every_s=0.0)
        before = await snapshots.text()
        snapshots.close()
        return before, await snapshots.text(), len(await snapshots.figures("light"))

    before, after, figures = asyncio.run(ask())
    assert json.loads(before)["sensors"][0]["rows"] == 100
    assert after == before
    assert figures > 0


def test_a_log_that_does_not_exist_yet_is_waited_for_and_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    served: list[Path] = []
    monkeypatch.setattr("imuarray.monitor.server.serve", lambda run, page: served.append(run))
    run = tmp_path / "night.h5"
    assert main(["monitor", str(run)]) == 0
    assert capsys.readouterr().err == f"imuarray: waiting for {run}, which does not exist yet\n"
    assert main(["monitor", str(run), "--parent", "1"]) == 0  # the page of `imuarray log --monitor`
    assert capsys.readouterr().err == ""
    assert served == [run, run]
