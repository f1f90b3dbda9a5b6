"""Mechanisms that make the emulated array differ from its data sheets.

Each is a physical effect or a fault: heat flow, ripple of the supply, bit errors of a cable, a switch that hangs. It
acts on an emulated chip, its wiring, the multiplexer or the host, and the real drivers poll the result. Mechanisms are
a second source of logs for the diagnosis of differences. They were written independently of the simulator, share
neither code nor form with it, and some of them have no name in it.

`at(severity)` gives a mechanism of `severity` times a stated reference size. `resembles` is for the sealed truth: the
effect names that are correct in a diagnosis. See `firmware_emulator.mechanisms.query` for the bus URL, and
`firmware_emulator.cases` for whole series of logs.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from firmware_emulator.mechanisms import converter, disturbances, host_time, mounting, power, response, thermal, wiring
from firmware_emulator.mechanisms.mechanism import Mechanism

__all__ = ["MECHANISMS", "Mechanism"]

MECHANISMS: Mapping[str, type[Mechanism]] = MappingProxyType(
    {
        "carrier_shot_noise": disturbances.CarrierShotNoise,
        "trapped_charges": disturbances.TrappedCharges,
        "stress_relaxation": disturbances.StressRelaxation,
        "single_trap": disturbances.SingleTrap,
        "output_filter": response.OutputFilter,
        "mains_ripple": disturbances.MainsRipple,
        "dropped_box": mounting.DroppedBox,
        "reference_voltage": response.ReferenceVoltage,
        "package_tilt": mounting.PackageTilt,
        "rotated_package": mounting.RotatedPackage,
        "plate_gap": response.PlateGap,
        "drive_imbalance": response.DriveImbalance,
        "thermistor_bow": thermal.ThermistorBow,
        "gain_resistor": thermal.GainResistor,
        "board_to_die": thermal.BoardToDie,
        "self_heating": thermal.SelfHeating,
        "stuck_bit": converter.StuckBit,
        "missing_codes": converter.MissingCodes,
        "soft_clipping": response.SoftClipping,
        "slow_oscillator": converter.SlowOscillator,
        "cable_bit_errors": wiring.CableBitErrors,
        "torn_reads": converter.TornReads,
        "converter_hold": converter.ConverterHold,
        "power_on_stress": power.PowerOnStress,
        "bias_current_dac": power.BiasCurrentDac,
        "brown_out": power.BrownOut,
        "range_switch": converter.RangeSwitch,
        "host_resonator": host_time.HostResonator,
        "scheduler_latency": host_time.SchedulerLatency,
        "loose_contact": wiring.LooseContact,
        "pipeline_delay": response.PipelineDelay,
        "rate_divider": converter.RateDivider,
        "supply_drift": power.SupplyDrift,
        "lever_arm": mounting.LeverArm,
        "crossed_wiring": mounting.CrossedWiring,
        "mux_hang": wiring.MuxHang,
        "adaptive_range": converter.AdaptiveRange,
        # The following mechanisms resemble no effect that has a name.
        "log_creep": power.LogCreep,
        "one_sided_noise": disturbances.OneSidedNoise,
        "spinning_motor": disturbances.SpinningMotor,
        "interleaved_converters": converter.InterleavedConverters,
        "keyed_transmitter": disturbances.KeyedTransmitter,
        "supply_droop": power.SupplyDroop,
        "thermal_hysteresis": thermal.ThermalHysteresis,
        "vibration_rectification": response.VibrationRectification,
        "mux_crosstalk": wiring.MuxCrosstalk,
        "coarse_timestamps": host_time.CoarseTimestamps,
        "reference_noise": disturbances.ReferenceNoise,
    }
)
"""Mechanisms by the name that a bus URL and a case use."""
