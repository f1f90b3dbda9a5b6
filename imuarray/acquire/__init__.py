"""From an array on a bus to a log: connect, poll, record; and look what answers."""

from imuarray.acquire.detect import Found, detect, explore
from imuarray.acquire.record import record
from imuarray.acquire.stations import Station, connect
from imuarray.acquire.summary import Summary

__all__ = ["Found", "Station", "Summary", "connect", "detect", "explore", "record"]
