"""DBC file of the driver's example: two lasers in messages of their own, and a message with multiplexed temperatures.

Both byte orders, counters that begin again after 0.3 s and 4 s, a timestamp and a value table are in it.
"""

from typing import Any

DBC = """VERSION ""

NS_ :

BS_:

BU_: Laser Host

BO_ 256 LaserX: 8 Laser
 SG_ Distance : 0|24@1- (0.0001,0) [-800|800] "mm" Host
 SG_ Count : 24|8@1+ (1,0) [0|255] "" Host
 SG_ Time : 32|32@1+ (1,0) [0|4294967295] "us" Host

BO_ 2147484160 LaserY: 6 Laser
 SG_ Distance : 7|16@0+ (0.5,0) [0|32767.5] "um" Host
 SG_ Count : 23|12@0+ (1,0) [0|4095] "" Host

BO_ 768 Status: 4 Laser
 SG_ Page M : 0|4@1+ (1,0) [0|15] "" Host
 SG_ HeadTemperature m0 : 8|16@1- (0.1,0) [-40|125] "degC" Host
 SG_ BoardTemperature m1 : 8|16@1- (0.1,0) [-40|125] "degC" Host

VAL_ 256 Distance 8388607 "NoTarget" ;
VAL_ 2147484160 Distance 65535 "NoTarget" ;
"""

SETTINGS: dict[str, Any] = {
    "dbc_text": DBC,
    "bitrate": 1_000_000,
    "x": {
        "message": "LaserX",
        "signal": "Distance",
        "counter": "Count",
        "timestamp": "Time",
        "rate_Hz": 1000.0,
        "invalid": ["NoTarget"],
    },
    "y": {
        "message": "LaserY",
        "signal": "Distance",
        "counter": "Count",
        "rate_Hz": 1000.0,
        "middle": 16_000.0,
        "positive": "towards",
        "invalid": ["NoTarget"],
    },
    "quantities": {
        "temperatures": {
            "message": "Status",
            "fields": {"head_degC": "HeadTemperature", "board_degC": "BoardTemperature"},
        }
    },
}
