"""Emulated adapters at paths such as /dev/i2c-1, for code of this process that expects real adapters.

::

    with device_files({"/dev/i2c-1": Adapter(wire)}):
        SMBus(1).read_byte_data(0x53, 0x00)

Inside the block `os.open` opens a real, empty file for each of these paths, and `fcntl.ioctl` on it is that of the
adapter, even if a module has imported the function by name. close and flock are the real ones. The read() and write()
of i2c-dev are not supported.

`Adapter` is a Linux I2C adapter over a `Wire`: the ioctls of /dev/i2c-N, with C structures at their addresses. Sources:
kernel documentation of i2c-dev, facts LNX-03 ... LNX-15 and LNX-40 ... LNX-49. SMBus calls become the messages to which
the kernel converts them (LNX-15). Packet error codes, addresses of ten bits, SMBus block reads, and all mangling flags
but I2C_M_STOP are not emulated and are refused with EOPNOTSUPP.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from firmware_emulator.wire import Wire

I2C_RETRIES, I2C_TIMEOUT, I2C_SLAVE, I2C_TENBIT = 0x0701, 0x0702, 0x0703, 0x0704
I2C_FUNCS, I2C_SLAVE_FORCE, I2C_RDWR, I2C_PEC, I2C_SMBUS = 0x0705, 0x0706, 0x0707, 0x0708, 0x0720

I2C_M_RD, I2C_M_STOP = 0x0001, 0x8000

FUNC_I2C, FUNC_PROTOCOL_MANGLING = 0x00000001, 0x00000004
FUNC_SMBUS = 0x0EFF0000  # emulated by the kernel on any I2C adapter, without packet error codes

MAX_MESSAGES = 42  # LNX-04
MAX_BYTES = 8192  # a message: LNX-05
MAX_BLOCK = 32  # an SMBus block: LNX-34
DEFAULT_TIMEOUT_NS = 1_000_000_000  # of the kernel, for adapters that name none
LARGEST_INT = 0x7FFFFFFF

QUICK, BYTE, BYTE_DATA, WORD_DATA, PROC_CALL, BLOCK_DATA, OLD_I2C_BLOCK, BLOCK_PROC_CALL, I2C_BLOCK = range(9)


class MessageStruct(ctypes.Structure):
    """``struct i2c_msg``."""

    _fields_ = (
        ("addr", ctypes.c_uint16),
        ("flags", ctypes.c_uint16),
        ("len", ctypes.c_uint16),
        ("buf", ctypes.c_void_p),
    )


class TransferStruct(ctypes.Structure):
    """``struct i2c_rdwr_ioctl_data``."""

    _fields_ = (("msgs", ctypes.c_void_p), ("nmsgs", ctypes.c_uint32))


class SmbusStruct(ctypes.Structure):
    """``struct i2c_smbus_ioctl_data``; `data` points to a union whose largest member is a block of 34 bytes."""

    _fields_ = (
        ("read_write", ctypes.c_uint8),
        ("command", ctypes.c_uint8),
        ("size", ctypes.c_uint32),
        ("data", ctypes.c_void_p),
    )


class Message(NamedTuple):
    """One message in the memory of the emulated kernel: `data` to write, or `length` bytes to read."""

    address: int
    flags: int
    data: bytes = b""
    length: int = 0


class Kind(NamedTuple):
    """The differences between adapters."""

    mangling: bool = False
    """Capability PROTOCOL_MANGLING: a message ends with a STOP when I2C_M_STOP requests it (LNX-08)."""
    one_read: bool = False
    """Reads are possible only in the last message (LNX-10)."""


KINDS: dict[str, Kind] = {"plain": Kind(), "bcm2835": Kind(one_read=True), "gpio": Kind(mangling=True)}
"""Kinds of adapter: one without limits, that of the Raspberry Pi, and one that drives two GPIO pins (LNX-09)."""


class Adapter:
    """One adapter: `kind` is a key of `KINDS`, `owned` contains the kernel driver of each address that has one.

    While `stuck` is set, the clock is held low: every transfer takes the whole timeout and ends with ETIMEDOUT.
    `timeout_ns` and `retries` are settings of programs; only a lost arbitration is retried (LNX-14), which never occurs
    here.
    """

    def __init__(self, wire: Wire, kind: str = "plain", owned: Mapping[int, str] | None = None) -> None:
        if kind not in KINDS:
            raise ValueError(f"adapter {kind!r}; allowed are {', '.join(KINDS)}")
        self.wire = wire
        self.kind = KINDS[kind]
        self.owned = dict(owned or {})
        self.timeout_ns = DEFAULT_TIMEOUT_NS
        self.retries = 0
        self.stuck = False

    @property
    def functionality(self) -> int:
        """Return the mask of I2C_FUNCS."""
        return FUNC_I2C | FUNC_SMBUS | (FUNC_PROTOCOL_MANGLING if self.kind.mangling else 0)

    def open(self) -> OpenFile:
        """Return the result of open("/dev/i2c-N") for a program, with its own address and flags."""
        return OpenFile(self)

    def transfer(self, messages: Sequence[Message]) -> list[bytes]:
        """Transfer a START, messages joined by repeated STARTs, and a STOP (LNX-06); return the bytes of each read.
        Raises the OSError that the kernel raises.
        """
        self._check(messages)
        if self.stuck:
            self.wire.clock.advance(self.timeout_ns)
            refuse(errno.ETIMEDOUT)
        received = []
        for message in messages:
            if message.flags & I2C_M_RD:
                received.append(self.wire.receive(message.address, message.length))
            else:
                self.wire.send(message.address, message.data)
            if message.flags & I2C_M_STOP and self.kind.mangling:
                self.wire.stop()
        self.wire.stop()
        return received

    def _check(self, messages: Sequence[Message]) -> None:
        if any(message.flags & ~(I2C_M_RD | I2C_M_STOP) for message in messages):
            refuse(errno.EOPNOTSUPP)
        if any(message.address > 0x7F for message in messages):
            refuse(errno.EINVAL)
        if self.kind.one_read and any(message.flags & I2C_M_RD for message in messages[:-1]):
            refuse(errno.EOPNOTSUPP)


class OpenFile:
    """One opening of an adapter: `ioctl` is the system call, its argument a number or the address of a structure."""

    def __init__(self, adapter: Adapter) -> None:
        self.adapter = adapter
        self.address = 0
        self._calls = {
            I2C_RETRIES: self._set_retries,
            I2C_TIMEOUT: self._set_timeout,
            I2C_SLAVE: self._set_free_address,
            I2C_SLAVE_FORCE: self._set_address,
            I2C_TENBIT: self._not_wanted,
            I2C_PEC: self._not_wanted,
            I2C_FUNCS: self._functionality,
            I2C_RDWR: self._transfer,
            I2C_SMBUS: self._smbus,
        }

    def ioctl(self, request: int, argument: int) -> int:
        """Return the system call's result; OSError with its errno. No data are copied back on error (LNX-13)."""
        call = self._calls.get(request)
        if call is None:
            refuse(errno.ENOTTY)
        return call(argument)

    def _set_retries(self, count: int) -> int:
        self.adapter.retries = checked(count, LARGEST_INT)
        return 0

    def _set_timeout(self, centiseconds: int) -> int:
        self.adapter.timeout_ns = checked(centiseconds, LARGEST_INT) * 10_000_000
        return 0

    def _set_free_address(self, address: int) -> int:
        if checked(address, 0x7F) in self.adapter.owned:
            refuse(errno.EBUSY)
        return self._set_address(address)

    def _set_address(self, address: int) -> int:
        self.address = checked(address, 0x7F)
        return 0

    def _not_wanted(self, switch: int) -> int:
        if switch:
            refuse(errno.EOPNOTSUPP)
        return 0

    def _functionality(self, argument: int) -> int:
        ctypes.c_ulong.from_address(pointer(argument)).value = self.adapter.functionality
        return 0

    def _transfer(self, argument: int) -> int:
        request = TransferStruct.from_address(pointer(argument))
        count = int(request.nmsgs)
        if not request.msgs or not 0 < count <= MAX_MESSAGES:
            refuse(errno.EINVAL)
        structs = list((MessageStruct * count).from_address(request.msgs))
        received = iter(self.adapter.transfer([message_at(struct) for struct in structs]))
        for struct in structs:
            if struct.flags & I2C_M_RD:
                put(struct.buf, next(received))
        return count

    def _smbus(self, argument: int) -> int:
        """Carry out I2C_SMBUS: the kernel's emulation, sent as messages."""
        call = SmbusStruct.from_address(pointer(argument))
        if call.size not in range(QUICK, I2C_BLOCK + 1) or call.read_write not in (0, 1):
            refuse(errno.EINVAL)
        if call.size in (QUICK, BYTE) and not (call.size == BYTE and call.read_write):
            self.adapter.transfer([self._strip_data(call)])
            return 0
        if not call.data:
            refuse(errno.EINVAL)
        data = ctypes.string_at(call.data, DATA_BYTES.get(call.size, MAX_BLOCK + 2))
        messages = self._messages(call, data)
        received = self.adapter.transfer(messages)
        if received:
            put(call.data, smbus_data(call.size, received[0]))
        return 0

    def _strip_data(self, call: SmbusStruct) -> Message:
        if call.size == BYTE:
            return self._write(bytes([call.command]))
        return self._read(0) if call.read_write else self._write(b"")

    def _messages(self, call: SmbusStruct, data: bytes) -> list[Message]:
        """Return the messages of a call with data."""
        size, command = call.size, bytes([call.command])
        if size == PROC_CALL:
            return [self._write(command + as_word(data)), self._read(2)]
        if size == BLOCK_PROC_CALL or (size == BLOCK_DATA and call.read_write):
            refuse(errno.EOPNOTSUPP)
        if size == BYTE:
            return [self._read(1)]
        if call.read_write:
            count = MAX_BLOCK if size == OLD_I2C_BLOCK else DATA_BYTES.get(size, data[0])
            return [self._write(command), self._read(checked(count, MAX_BLOCK))]
        return [self._write(command + outgoing(size, data))]

    def _write(self, data: bytes) -> Message:
        return Message(self.address, 0, data)

    def _read(self, count: int) -> Message:
        return Message(self.address, I2C_M_RD, length=count)


DATA_BYTES = {BYTE: 1, BYTE_DATA: 1, WORD_DATA: 2, PROC_CALL: 2}
"""Size of the union's member by SMBus size; the other SMBus sizes use the block."""


def refuse(number: int) -> NoReturn:
    """Raise the OSError of the system call."""
    raise OSError(number, os.strerror(number))


def checked(value: int, largest: int) -> int:
    """Return `value`; OSError with EINVAL if it is above `largest`."""
    if value > largest:
        refuse(errno.EINVAL)
    return value


def pointer(at: int) -> int:
    """Return `at`; OSError with EFAULT if it is in the first page, like a null pointer."""
    if at < 4096:
        refuse(errno.EFAULT)
    return at


def put(at: int, data: bytes) -> None:
    """Copy the data to the program's memory."""
    ctypes.memmove(pointer(at), data, len(data))


def message_at(struct: MessageStruct) -> Message:
    """Return the message that a structure describes, with a copy of the bytes to write (LNX-05)."""
    count = checked(struct.len, MAX_BYTES)
    if count:
        pointer(struct.buf or 0)
    if struct.flags & I2C_M_RD:
        return Message(struct.addr, struct.flags, length=count)
    return Message(struct.addr, struct.flags, ctypes.string_at(struct.buf, count) if count else b"")


def as_word(data: bytes) -> bytes:
    """Convert a word between the byte order of this machine and that of SMBus, low byte first (LNX-16)."""
    return data[:2] if sys.byteorder == "little" else data[1::-1]


def outgoing(size: int, data: bytes) -> bytes:
    """Return the bytes after the command of a write: byte, word, or block with its length (SMBus) or without (I2C)."""
    if size == BYTE_DATA:
        return data
    if size == WORD_DATA:
        return as_word(data)
    end = 1 + checked(data[0], MAX_BLOCK)
    return data[:end] if size == BLOCK_DATA else data[1:end]


def smbus_data(size: int, received: bytes) -> bytes:
    """Return the union after a read."""
    if size in (WORD_DATA, PROC_CALL):
        return as_word(received)
    return received if size in DATA_BYTES else bytes([len(received)]) + received


Identity = tuple[int, int]


@contextmanager
def device_files(adapters: Mapping[str, Adapter]) -> Iterator[None]:
    """Serve `adapters` by path to all code of this process inside the block."""
    real_ioctl, real_open = fcntl.ioctl, os.open

    def ioctl(fd: Any, request: int, arg: Any = 0, mutate_flag: bool = True, /) -> Any:
        file = served.file(fd if isinstance(fd, int) else fd.fileno())
        if file is None:
            return real_ioctl(fd, request, arg, mutate_flag)
        return with_address(arg, lambda argument: file.ioctl(request, argument))

    def opened(path: Any, *args: Any, **keywords: Any) -> int:
        return served.opened(real_open(served.stand_in(path), *args, **keywords))

    with tempfile.TemporaryDirectory() as folder:
        served = _DeviceFolder(adapters, Path(folder))
        replace_everywhere("ioctl", real_ioctl, ioctl)
        replace_everywhere("open", real_open, opened)
        try:
            yield
        finally:
            replace_everywhere("open", opened, real_open)
            replace_everywhere("ioctl", ioctl, real_ioctl)


def replace_everywhere(name: str, old: object, new: object) -> None:
    """Replace `old` by `new` under `name` in every module that has imported it."""
    for module in list(sys.modules.values()):
        if getattr(module, "__dict__", {}).get(name) is old:
            setattr(module, name, new)


class _DeviceFolder:
    """The adapters of one block: the file of each adapter, and the open descriptors."""

    def __init__(self, adapters: Mapping[str, Adapter], folder: Path) -> None:
        self._stand_ins: dict[str, Path] = {}
        self._adapters: dict[Identity, Adapter] = {}
        self._open_files: dict[int, OpenFile] = {}
        for path, adapter in adapters.items():
            stand_in = folder / path.replace("/", "_")
            stand_in.touch()
            self._stand_ins[path] = stand_in
            self._adapters[identity(stand_in.stat())] = adapter

    def stand_in(self, path: Any) -> Any:
        """Return the file that represents `path`; `path` itself if it is not the path of an emulated adapter."""
        return self._stand_ins.get(os.fspath(path), path) if isinstance(path, str | os.PathLike) else path

    def opened(self, number: int) -> int:
        """Note that a descriptor was opened: settings of an earlier one with this number are discarded."""
        self._open_files.pop(number, None)
        return number

    def file(self, number: int) -> OpenFile | None:
        """Return the opened adapter of a descriptor; None for any other file."""
        adapter = self._adapters.get(identity(os.fstat(number)))
        if adapter is None:
            return None
        return self._open_files.setdefault(number, adapter.open())


def identity(status: os.stat_result) -> Identity:
    """Return the identity of a file: device and inode."""
    return status.st_dev, status.st_ino


def with_address(argument: Any, call: Callable[[int], int]) -> Any:
    """Call `call` with a Python argument as `fcntl.ioctl` does: a number is passed unchanged, a buffer by its address,
    and immutable bytes as a copy, which is then the result.
    """
    if isinstance(argument, int):
        return call(argument)
    if isinstance(argument, bytes):
        copy = ctypes.create_string_buffer(argument, len(argument))
        call(ctypes.addressof(copy))
        return copy.raw
    memory = (ctypes.c_char * memoryview(argument).nbytes).from_buffer(argument)
    return call(ctypes.addressof(memory))
