"""From an array on a bus to a log: connect, poll, record; and look what answers."""

from imuarray.acquire.detect import Found, detect, explore
from imuarray.acquire.record import record
from imuarray.acquire.sensor_routes import SensorRoute, connect
from imuarray.acquire.summary import Summary

__all__ = ["Found", "SensorRoute", "Summary", "connect", "detect", "explore", "record"]
