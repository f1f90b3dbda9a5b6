"""Registers as the data sheets print them: address, access, reset value, bit fields. Nothing else.

These facts are written once and read by the driver and by the emulated chip alike. What a data sheet says in prose
(byte order, sign, auto-increment, unlocking, timing, every scale factor) is *behaviour* and is written twice,
independently, in `imuarray.drivers` and in `firmware_emulator.chips`. Ids such as BMA-26 are
explained in `SOURCES.md` beside this file.
"""
