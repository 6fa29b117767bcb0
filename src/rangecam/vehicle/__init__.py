"""The vehicle: how it moves, what it measures of itself, and its own control unit on the bus.

- settings: what a vehicle is; `VEHICLES`
- dynamics: forces at its tyres, brakes that take their time
- sensors: speed, voltages, currents, temperatures
- unit: remote control or control by the bus, in frames of the bus
"""
