"""The emulated array behind a TCP port, one I2C adapter a bus, for Linux's USB/IP client.

USB/IP knows neither passwords nor encryption: whoever reaches the port has the bus. One thread serves everybody, so
that nothing is ever done to the wire twice at once.
"""

from __future__ import annotations

import selectors
import socket
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Self

from firmware_emulator.tiny_usb import TinyUsb
from firmware_emulator.usbip import Conversation, Export, ProtocolError
from firmware_emulator.wire import Wire

DEFAULT_HOST, DEFAULT_PORT = "127.0.0.1", 3240
MAX_CONNECTIONS = 16
PATIENCE_S = 10.0
"""How long a client may take to say what it wants, or to take what it asked for."""
CHUNK = 65536


class Client:
    """One connection."""

    def __init__(self, connection: socket.socket, name: str, conversation: Conversation) -> None:
        self.connection = connection
        self.name = name
        self.conversation = conversation
        self.since_s = time.monotonic()

    def serve(self) -> bool:
        """Answer the requests that have arrived; return False at their end. Raises OSError or ProtocolError."""
        data = self.connection.recv(CHUNK)
        for answer in self.conversation.feed(data):
            self.connection.sendall(answer)
        return bool(data) and not self.conversation.over

    def dawdles(self) -> bool:
        """Connected a while ago, and wants nothing yet."""
        return self.conversation.imported is None and time.monotonic() - self.since_s > PATIENCE_S


class UsbipServer:
    """Serves `wires` (by name of the bus, "" for the trunk) as busid 1-1, 1-2, ...; OSError if the port can't be had.

    `title` is what the adapters call themselves; `log` gets one line for everything that happens to a client.
    """

    def __init__(
        self,
        wires: Mapping[str, Wire],
        title: str,
        host: str = DEFAULT_HOST,
        port: int = DEFAULT_PORT,
        log: Callable[[str], None] = lambda line: None,
    ) -> None:
        titles = [f"{title} {name}".strip() for name in wires]
        devices = [TinyUsb(wire, text) for wire, text in zip(wires.values(), titles, strict=True)]
        self.exports = tuple(Export(port, device) for port, device in enumerate(devices, 1))
        self.titles = dict(zip([export.busid for export in self.exports], titles, strict=True))
        self._log = log
        self._listener = socket.create_server((host, port), family=family_of(host))
        self._waker, self._woken = socket.socketpair()
        self._clients: list[Client] = []
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ, self._accept)
        self._selector.register(self._woken, selectors.EVENT_READ)

    @property
    def address(self) -> tuple[str, int]:
        """Host and port: the one that was given by the system for port 0."""
        host, port = self._listener.getsockname()[:2]
        return host, port

    def serve_forever(self) -> None:
        """Serve until `shutdown`, which another thread may call."""
        while True:
            for key, _ in self._selector.select(PATIENCE_S / 4):
                if key.fileobj is self._woken:
                    return
                key.data()
            for client in [client for client in self._clients if client.dawdles()]:
                self._drop(client, "said nothing")

    def shutdown(self) -> None:
        """Let `serve_forever` return."""
        self._waker.send(b"\0")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for client in list(self._clients):
            self._drop(client, "")
        self._selector.close()
        for endpoint in (self._listener, self._waker, self._woken):
            endpoint.close()

    def _accept(self) -> None:
        try:
            connection, peer = self._listener.accept()
        except OSError:  # it has gone again
            return
        name = f"{peer[0]}:{peer[1]}"
        if len(self._clients) >= MAX_CONNECTIONS:
            connection.close()
            self._log(f"{name}: refused, {MAX_CONNECTIONS} are connected")
            return
        connection.settimeout(PATIENCE_S)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        client = Client(connection, name, Conversation(self.exports))
        self._clients.append(client)
        self._selector.register(connection, selectors.EVENT_READ, partial(self._serve, client))

    def _serve(self, client: Client) -> None:
        had = client.conversation.imported
        try:
            goes_on, why = client.serve(), ""
        except ProtocolError as error:
            goes_on, why = False, f"not USB/IP: {error}"
        except OSError as error:
            goes_on, why = False, str(error)
        now = client.conversation.imported
        if now is not had and now is not None:
            self._log(f"{client.name}: attached {now.busid}")
        if not goes_on:
            self._drop(client, why or (f"detached {now.busid}" if now else ""))

    def _drop(self, client: Client, why: str) -> None:
        """Close the connection, and say why if there is something to say."""
        self._selector.unregister(client.connection)
        self._clients.remove(client)
        client.conversation.close()
        client.connection.close()
        if why:
            self._log(f"{client.name}: {why}; closed")


def family_of(host: str) -> socket.AddressFamily:
    """IPv6 for an address with colons."""
    return socket.AF_INET6 if ":" in host else socket.AF_INET
