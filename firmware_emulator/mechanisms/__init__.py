"""Mechanisms that make the emulated array differ from what its data sheets promise.

Each is a piece of physics or a fault: heat that flows, a supply that hums, a cable that errs, a switch that hangs. It
acts on an emulated chip, its wiring, the multiplexer or the host, and the real drivers poll the result. Mechanisms are
a second source of logs for the diagnosis of differences: they were written apart from the simulator, share neither code
nor form with it, and some of them have no name there.

`at(severity)` gives a mechanism of `severity` times a stated reference size. `resembles` is for the sealed truth: the
names by which a diagnosis may rightly call it. See `firmware_emulator.mechanisms.query` for the bus URL, and
`firmware_emulator.cases` for whole series of logs.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from firmware_emulator.mechanisms.adaptive_range import AdaptiveRange
from firmware_emulator.mechanisms.bias_current_dac import BiasCurrentDac
from firmware_emulator.mechanisms.board_to_die import BoardToDie
from firmware_emulator.mechanisms.brown_out import BrownOut
from firmware_emulator.mechanisms.cable_bit_errors import CableBitErrors
from firmware_emulator.mechanisms.carrier_shot_noise import CarrierShotNoise
from firmware_emulator.mechanisms.coarse_timestamps import CoarseTimestamps
from firmware_emulator.mechanisms.converter_hold import ConverterHold
from firmware_emulator.mechanisms.crossed_wiring import CrossedWiring
from firmware_emulator.mechanisms.drive_imbalance import DriveImbalance
from firmware_emulator.mechanisms.dropped_box import DroppedBox
from firmware_emulator.mechanisms.gain_resistor import GainResistor
from firmware_emulator.mechanisms.host_resonator import HostResonator
from firmware_emulator.mechanisms.interleaved_converters import InterleavedConverters
from firmware_emulator.mechanisms.keyed_transmitter import KeyedTransmitter
from firmware_emulator.mechanisms.lever_arm import LeverArm
from firmware_emulator.mechanisms.log_creep import LogCreep
from firmware_emulator.mechanisms.loose_contact import LooseContact
from firmware_emulator.mechanisms.mains_ripple import MainsRipple
from firmware_emulator.mechanisms.mechanism import Mechanism
from firmware_emulator.mechanisms.missing_codes import MissingCodes
from firmware_emulator.mechanisms.mux_crosstalk import MuxCrosstalk
from firmware_emulator.mechanisms.mux_hang import MuxHang
from firmware_emulator.mechanisms.one_sided_noise import OneSidedNoise
from firmware_emulator.mechanisms.output_filter import OutputFilter
from firmware_emulator.mechanisms.package_tilt import PackageTilt
from firmware_emulator.mechanisms.pipeline_delay import PipelineDelay
from firmware_emulator.mechanisms.plate_gap import PlateGap
from firmware_emulator.mechanisms.power_on_stress import PowerOnStress
from firmware_emulator.mechanisms.range_switch import RangeSwitch
from firmware_emulator.mechanisms.rate_divider import RateDivider
from firmware_emulator.mechanisms.reference_noise import ReferenceNoise
from firmware_emulator.mechanisms.reference_voltage import ReferenceVoltage
from firmware_emulator.mechanisms.rotated_package import RotatedPackage
from firmware_emulator.mechanisms.scheduler_latency import SchedulerLatency
from firmware_emulator.mechanisms.self_heating import SelfHeating
from firmware_emulator.mechanisms.single_trap import SingleTrap
from firmware_emulator.mechanisms.slow_oscillator import SlowOscillator
from firmware_emulator.mechanisms.soft_clipping import SoftClipping
from firmware_emulator.mechanisms.spinning_motor import SpinningMotor
from firmware_emulator.mechanisms.stress_relaxation import StressRelaxation
from firmware_emulator.mechanisms.stuck_bit import StuckBit
from firmware_emulator.mechanisms.supply_drift import SupplyDrift
from firmware_emulator.mechanisms.supply_droop import SupplyDroop
from firmware_emulator.mechanisms.thermal_hysteresis import ThermalHysteresis
from firmware_emulator.mechanisms.thermistor_bow import ThermistorBow
from firmware_emulator.mechanisms.torn_reads import TornReads
from firmware_emulator.mechanisms.trapped_charges import TrappedCharges
from firmware_emulator.mechanisms.vibration_rectification import VibrationRectification

__all__ = ["MECHANISMS", "Mechanism"]

MECHANISMS: Mapping[str, type[Mechanism]] = MappingProxyType(
    {
        "carrier_shot_noise": CarrierShotNoise,
        "trapped_charges": TrappedCharges,
        "stress_relaxation": StressRelaxation,
        "single_trap": SingleTrap,
        "output_filter": OutputFilter,
        "mains_ripple": MainsRipple,
        "dropped_box": DroppedBox,
        "reference_voltage": ReferenceVoltage,
        "package_tilt": PackageTilt,
        "rotated_package": RotatedPackage,
        "plate_gap": PlateGap,
        "drive_imbalance": DriveImbalance,
        "thermistor_bow": ThermistorBow,
        "gain_resistor": GainResistor,
        "board_to_die": BoardToDie,
        "self_heating": SelfHeating,
        "stuck_bit": StuckBit,
        "missing_codes": MissingCodes,
        "soft_clipping": SoftClipping,
        "slow_oscillator": SlowOscillator,
        "cable_bit_errors": CableBitErrors,
        "torn_reads": TornReads,
        "converter_hold": ConverterHold,
        "power_on_stress": PowerOnStress,
        "bias_current_dac": BiasCurrentDac,
        "brown_out": BrownOut,
        "range_switch": RangeSwitch,
        "host_resonator": HostResonator,
        "scheduler_latency": SchedulerLatency,
        "loose_contact": LooseContact,
        "pipeline_delay": PipelineDelay,
        "rate_divider": RateDivider,
        "supply_drift": SupplyDrift,
        "lever_arm": LeverArm,
        "crossed_wiring": CrossedWiring,
        "mux_hang": MuxHang,
        "adaptive_range": AdaptiveRange,
        # What follows resembles no effect that has a name.
        "log_creep": LogCreep,
        "one_sided_noise": OneSidedNoise,
        "spinning_motor": SpinningMotor,
        "interleaved_converters": InterleavedConverters,
        "keyed_transmitter": KeyedTransmitter,
        "supply_droop": SupplyDroop,
        "thermal_hysteresis": ThermalHysteresis,
        "vibration_rectification": VibrationRectification,
        "mux_crosstalk": MuxCrosstalk,
        "coarse_timestamps": CoarseTimestamps,
        "reference_noise": ReferenceNoise,
    }
)
"""Mechanisms by the name that a bus URL and a case use."""
