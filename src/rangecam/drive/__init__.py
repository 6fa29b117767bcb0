"""The closed loop: scene, camera, perception, brake, bus and vehicle in simulated time, once or in thousands.

- settings: vehicle, road, driver, latencies, faults of a drive
- loop: `drive`, one drive; eye: its camera; mind: the system under test; journey: its way and driver; faults
- contact: what the vehicle touches; bound: what could have been done
- result, page: what a drive came to
- campaigns: thousands of drives, their table and their page
"""
