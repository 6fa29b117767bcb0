"""The CAN bus of the scaled car: layout and codec of its messages, and the bus itself."""
