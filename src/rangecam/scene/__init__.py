"""The simulated world: shapes that move along paths, seen by rays; scenarios put them together.

Import from the modules: `scenario` (what exists), `bodies` (what it is made of), `paths` (where it is), `render` (what
a camera sees), `view`.
"""
