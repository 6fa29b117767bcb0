"""What the take-over frame is made of (Steinbäck 2016, tables A.1 and A.5); `messages.dbc` says it to tools."""

MASTER_ID = 0x50
"""Identifier of the take-over and of the give-back: the lowest of all, so that it wins the bus."""
MAGIC = bytes([0xCA, 0xFE])
"""Bytes 6 and 7 of a take-over; any other frame with this identifier gives control back."""
BRAKE_MODE = 3
"""Auto Mode; 1 forward, 2 backward, 0 none, so that an empty frame drives nothing."""
VALUE_PER_UNIT = 1000
"""Auto Value counts thousandths of the full actuator, little endian."""
GIVE_BACK_DATA = bytes(8)
"""All zero: no mode, no value, no magic number."""
