"""Heat takes its way through the board before it reaches the mass that moves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Self

from firmware_emulator.mechanisms.mechanism import SensorMechanism
from firmware_emulator.mechanisms.site import Site, Stopwatch
from firmware_emulator.world import Stimulus


@dataclass(frozen=True)
class BoardToDie(SensorMechanism):
    """Two nodes: board dTb/dt = (T - Tb) / `board_s`, die dTd/dt = (Tb - Td) / `die_s`; bias follows Td.

    The chip's thermometer, on the side of the pads, shows Tb. Under a ramp of T it is late by board_s, the bias by
    board_s + die_s. Reference: 6 s and 2 s.
    """

    board_s: float = 6.0
    die_s: float = 2.0

    resembles: ClassVar[tuple[str, ...]] = ("thermal_lag",)

    @classmethod
    def at(cls, severity: float) -> Self:
        """Return one with more heat capacity in both nodes."""
        return cls(board_s=cls.board_s * severity, die_s=cls.die_s * severity)

    def put_on(self, site: Site) -> None:
        """The two nodes begin at the temperature that is first felt."""
        elapsed = Stopwatch()
        board = die = math.nan

        def felt(at_ns: int, stimulus: Stimulus) -> Stimulus:
            nonlocal board, die
            seconds, degc = elapsed(at_ns), stimulus.temperature_degc
            if math.isnan(board):
                board = die = degc
            if board == die == degc:
                return stimulus
            die += (board - die) * -math.expm1(-seconds / self.die_s)
            board += (degc - board) * -math.expm1(-seconds / self.board_s)
            return stimulus._replace(temperature_degc=die)

        site.chain.felt.append(felt)
        site.chain.thermometer.append(lambda at_ns, degc: degc if math.isnan(board) else board)
