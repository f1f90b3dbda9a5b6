"""Properties of any table of register facts, and of ours by the data sheets' register maps.

`complaints` is used by test_tables.py and, on tables with one wrong fact, by mutation.py.
"""

from __future__ import annotations

from types import ModuleType

from imuarray.facts.registers import Field, Register

CHIPS = (
    "adxl345",
    "ak8963",
    "ak8975",
    "bma180",
    "bmp180",
    "bmp280",
    "bmp388",
    "hmc5883",
    "icm42688",
    "l3g4200d",
    "lis3mdl",
    "lsm6dso",
    "mmc5983",
    "mpu6050",
    "mpu6500",
    "pca9544a",
)

# By chip: addresses that can't be written, addresses that are only written, all the others. Column "acc" of the maps:
# ADX-10 ... ADX-29, BMA-10 ... BMA-47, BMP-10 ... BMP-16, BMP-102 ... BMP-111, HMC-10 ... HMC-17, L3G-10 ... L3G-25,
# INV-10 ... INV-29 (FIFO_COUNT: see SOURCES.md), INV-71, TDK-10, LSM-10, PCA-03. In bank n addresses have 0x100 n
# added.
READ_ONLY = {
    "adxl345": {0x00, 0x2B, 0x30, *range(0x32, 0x38), 0x39},
    "ak8963": {*range(0x0A), *range(0x10, 0x13)},
    "ak8975": {*range(0x0A), *range(0x10, 0x13)},
    "bma180": {*range(0x0D)},
    "bmp180": {0xAA, 0xD0, 0xF6, 0xF7, 0xF8},
    "bmp280": {0x88, 0xD0, 0xF3, *range(0xF7, 0xFD)},
    "bmp388": {0x00, *range(0x02, 0x0A), 0x31},
    "hmc5883": {*range(0x03, 0x0D)},
    "icm42688": {*range(0x1D, 0x2B), *range(0x2D, 0x31), 0x75, *range(0x162, 0x165)},
    "l3g4200d": {0x0F, *range(0x26, 0x2E), 0x2F, 0x31},
    "lis3mdl": {0x0F, *range(0x27, 0x30)},
    "lsm6dso": {0x0F, 0x1E, *range(0x20, 0x2E), 0x3A, 0x3B, 0x40, 0x41, 0x43, 0x63, *range(0x78, 0x7F)},
    "mmc5983": {*range(0x08), 0x2F},
    "mpu6050": {*range(0x3A, 0x49), 0x72, 0x73, 0x75},
    "mpu6500": {0x36, *range(0x3A, 0x4A), 0x72, 0x73, 0x75},
    "pca9544a": set(),
}
WRITE_ONLY = {
    "adxl345": set(),
    "ak8963": set(),
    "ak8975": set(),
    "bma180": {0x10},
    "bmp180": {0xE0},
    "bmp280": {0xE0},
    "bmp388": {0x7E},
    "hmc5883": set(),
    "icm42688": set(),
    "l3g4200d": set(),
    "lis3mdl": set(),
    "lsm6dso": set(),
    "mmc5983": {*range(0x09, 0x0D)},
    "mpu6050": set(),
    "mpu6500": set(),
    "pca9544a": set(),
}
WRITABLE = {
    "adxl345": {*range(0x1D, 0x2B), *range(0x2C, 0x30), 0x31, 0x38},
    "ak8963": {0x0A, 0x0B, 0x0C},
    "ak8975": {0x0A, 0x0C},
    "bma180": {0x0D, 0x0E, 0x0F, *range(0x20, 0x3C)},
    "bmp180": {0xF4},
    "bmp280": {0xF4, 0xF5},
    "bmp388": {0x1B, 0x1C, 0x1D, 0x1F},
    "hmc5883": {0x00, 0x01, 0x02},
    "icm42688": {
        *(0x11, 0x16, *range(0x4B, 0x55), *range(0x5F, 0x62), 0x70, 0x76),
        *(*range(0x10B, 0x10F), *range(0x15F, 0x162), 0x17B),
        *(*range(0x203, 0x206), *range(0x23B, 0x23E)),
    },
    "l3g4200d": {*range(0x20, 0x26), 0x2E, 0x30, *range(0x32, 0x39)},
    "lis3mdl": {*range(0x05, 0x0B), *range(0x20, 0x25), 0x32},
    "lsm6dso": {0x01, 0x07, 0x09, 0x0A, *range(0x10, 0x1A), 0x42},
    "mmc5983": {0x08},
    "mpu6050": {0x00, *range(0x0D, 0x11), *range(0x19, 0x1D), 0x23, 0x37, 0x38, 0x63, *range(0x6A, 0x6D), 0x74},
    "mpu6500": {
        *range(0x03),
        *range(0x0D, 0x10),
        *range(0x19, 0x1E),
        *range(0x23, 0x31),
        0x34,
        0x37,
        *range(0x63, 0x68),
        *range(0x6A, 0x6D),
        0x74,
    },
    "pca9544a": {0x00},
}
ADDRESSES = {  # ADX-01, BMA-01, BMP-01, BMP-101, HMC-01, TDK-01, L3G-01, LSM-01, INV-01, INV-70, PCA-01
    "adxl345": {0x53, 0x1D},
    "ak8963": {0x0C},
    "ak8975": {0x0C},
    "bma180": {0x40, 0x41},
    "bmp180": {0x77},
    "bmp280": {0x76, 0x77},
    "bmp388": {0x76, 0x77},
    "hmc5883": {0x1E},
    "icm42688": {0x68, 0x69},
    "l3g4200d": {0x68, 0x69},
    "lis3mdl": {0x1C, 0x1E},
    "lsm6dso": {0x6A, 0x6B},
    "mmc5983": {0x30},
    "mpu6050": {0x68, 0x69},
    "mpu6500": {0x68, 0x69},
    "pca9544a": {0x70, 0x71, 0x72, 0x73, 0x74, 0x75, 0x76, 0x77},
}
RESERVED_WITHOUT_FIELDS = {  # by address, in registers of which no field is named: ADX-19, L3G-24 (15-bit thresholds)
    "adxl345": {0x2A: 0xF0},
    "l3g4200d": {0x32: 0x80, 0x34: 0x80, 0x36: 0x80},
}
UNPRINTED = {  # without a reset value in print: measured, computed when read, never readable, different in every part
    "adxl345": {0x30, *range(0x32, 0x38), 0x39},
    "ak8963": {0x01, 0x02, *range(0x03, 0x0A), *range(0x10, 0x13)},
    "ak8975": {0x01, 0x02, *range(0x03, 0x0A), *range(0x10, 0x13)},
    "bma180": {*range(0x01, 0x09), 0x3B},
    "bmp180": {0xAA},
    "bmp280": {0x88, 0xF3},
    "bmp388": {0x03, 0x31},
    "hmc5883": {0x09},
    "icm42688": {0x2E, 0x2F, 0x30, *range(0x15F, 0x165), *range(0x23B, 0x23E)},
    "l3g4200d": {*range(0x26, 0x2E), 0x2F},
    "lis3mdl": {*range(0x27, 0x30)},
    "lsm6dso": {0x1E, *range(0x20, 0x2E), 0x3A, 0x3B, *range(0x78, 0x7F)},
    "mmc5983": {*range(0x0D)},
    "mpu6500": {*range(0x03), *range(0x0D, 0x10), 0x3A, 0x72, 0x73, 0x74},
    "mpu6050": {*range(0x0D, 0x11), 0x3A, 0x72, 0x73, 0x74},
}


def registers(facts: ModuleType) -> dict[str, Register]:
    """Registers by name."""
    return {name: fact for name, fact in vars(facts).items() if isinstance(fact, Register)}


def place_of(register: Register) -> int:
    """The address, and the bank from bit 8 on."""
    return register.bank << 8 | register.address


def fields(facts: ModuleType) -> dict[str, Field]:
    """Fields by name."""
    return {name: fact for name, fact in vars(facts).items() if isinstance(fact, Field)}


def complaints(chip: str, facts: ModuleType) -> list[str]:
    """Everything that is wrong with the table of `chip`, a line each."""
    return [*_addresses(chip, facts), *_access(chip, facts), *_bytes(chip, facts), *_tiles(chip, facts)]


def _addresses(chip: str, facts: ModuleType) -> list[str]:
    problems = []
    if set(facts.ADDRESSES) != ADDRESSES[chip] or len(facts.ADDRESSES) != len(ADDRESSES[chip]):
        problems.append(f"bus addresses {facts.ADDRESSES}")
    used: dict[int, str] = {}
    for name, register in registers(facts).items():
        if place_of(register) in used:
            problems.append(f"{name} is at {register.address:#04x}, where {used[place_of(register)]} is")
        used[place_of(register)] = name
    return problems


def _access(chip: str, facts: ModuleType) -> list[str]:
    problems = []
    for access, addresses in {"r": READ_ONLY[chip], "w": WRITE_ONLY[chip], "rw": WRITABLE[chip]}.items():
        places = {place_of(register) for register in registers(facts).values() if register.access == access}
        if places != addresses:
            problems.append(f"access {access}: registers {sorted(map(hex, places ^ addresses))} disagree")
    return problems


def _bytes(chip: str, facts: ModuleType) -> list[str]:
    """Resets and reserved masks are bytes, no reset sets a reserved bit, and none is invented."""
    problems = []
    for name, register in registers(facts).items():
        reset, reserved = register.reset, register.reserved
        if not (0 <= reset <= 0xFF and 0 <= reserved <= 0xFF) or reset & reserved:
            problems.append(f"{name}: reset {reset:#x}, reserved {reserved:#x}")
        if reset and place_of(register) in UNPRINTED.get(chip, ()):
            problems.append(f"{name}: no reset value is printed, {reset:#04x} is said")
    return problems


def _tiles(chip: str, facts: ModuleType) -> list[str]:
    """In a register that has named fields, every bit belongs to one field or is reserved, and none to two."""
    problems = []
    for name, register in registers(facts).items():
        own = {key: field for key, field in fields(facts).items() if field.register == register}
        taken = register.reserved
        for key, field in own.items():
            if taken & field.mask:
                problems.append(f"{key} overlaps another field or reserved bits of {name}")
            taken |= field.mask
        if own and taken != 0xFF:
            problems.append(f"{name}: bits {~taken & 0xFF:#04x} belong to no field")
        if not own and taken != RESERVED_WITHOUT_FIELDS.get(chip, {}).get(register.address, 0):
            problems.append(f"{name}: reserved {taken:#04x}, which no field bounds")
    known = set(registers(facts).values())
    lost = [key for key, field in fields(facts).items() if field.register not in known]
    return problems + [f"{key}: its register has no name" for key in lost]
