"""The register map of the continuous-wave sensor, and the list that is sent to it before the first image.

Names and values are those of Steinbäck 2016, A.10, where no address is printed; addresses are those of public register
maps of the same family of sensors. Registers without a meaning in `cw.registers` (pads, references, interface) are
known and taken, and change nothing.
"""

from collections.abc import Mapping

LAST_ENTRY = 31
"""Number of the last entry of an exposure sequence, counted from 0."""
OF_AN_ENTRY = ("EXPOTIME", "FRAMERATE", "PS", "PLLSET")
"""Registers of each entry."""
_PADS = {f"ANAIP_PADGPIOCFG{k}": 0xB00E + k for k in range(12)}
_ANALOGUE = {
    "ANAIP_SENSEN": 0xB002,
    "ANAIP_GPIOMUX5": 0xB008,
    "ANAIP_GPIOMUX7": 0xB00A,
    "ANAIP_ADCBG1": 0xB01C,
    "ANAIP_ADCEN": 0xB01E,
    "ANAIP_ADCRESET": 0xB01F,
    "ANAIP_PIXIFEN": 0xB041,
    "ANAIP_PIXREFBGEN": 0xB042,
    "ANAIP_PIXREFEN": 0xB043,
    "ANAIP_PLLBGEN": 0xB048,
    "ANAIP_PSPADCFG": 0xB086,
    "ANAIP_VMODREG": 0xB0A2,
}
_ENTRIES = {
    f"CFGCNT_S{k:02}_{name}": 0xA800 + 4 * k + i for k in range(LAST_ENTRY + 1) for i, name in enumerate(OF_AN_ENTRY)
}
_COUNTER = (
    *("TRIG", "STATUS", "CSICFG", "PIFCCFG", "PIFTCFG", "BINCFG", "ROICMINREG", "ROICMAXREG", "ROIRMINREG"),
    *("ROIRMAXREG", "ROS1", "ROS2", "IFDEL", "CTRLSEQ", "EXPCFG1", "EXPCFG2", "EXPCFG3", "EXPCFG4", "PSOUT"),
    *(f"PLLCFG{i}_LUT{k}" for k in (1, 2, 3, 4) for i in (1, 2, 3)),
)
ADDRESSES: Mapping[str, int] = {
    **_ANALOGUE,
    **_PADS,
    **_ENTRIES,
    **{f"CFGCNT_{name}": 0xA880 + i for i, name in enumerate(_COUNTER)},
    "MTCU_POWERCTRL": 0x9813,
    "PIF_PIFHSIZE": 0x8001,
    "PIF_PIFVSIZE": 0x8002,
}
"""Address of each register by name, 16 bits."""
NAMES = {address: name for name, address in ADDRESSES.items()}

_ANALOGUE_LIST = (
    *(("SENSEN", 0x00FF), ("GPIOMUX5", 0x0180), ("GPIOMUX7", 0x018D)),
    *((f"PADGPIOCFG{k}", 0x1515) for k in range(6)),
    *(("PADGPIOCFG6", 0x1315), ("PADGPIOCFG7", 0x1513), ("PADGPIOCFG8", 0x1515), ("PADGPIOCFG9", 0x0415)),
    *(("PADGPIOCFG10", 0x0404), ("PADGPIOCFG11", 0x0004), ("ADCBG1", 0x0003), ("ADCEN", 0xFFFF), ("ADCRESET", 0x0001)),
    *(("PIXIFEN", 0xFFFF), ("PIXREFBGEN", 0x0003), ("PIXREFEN", 0xFFFF), ("PLLBGEN", 0x0001), ("PSPADCFG", 0x1513)),
    ("VMODREG", 0x0007),
)
_SEQUENCE_LIST = tuple(
    (f"S{k:02}_{name}", value)
    for k, (delay, phase) in enumerate([(0, 0x0000), (0, 0x0888), (0, 0x0444), (0x1000, 0x0CCC)])
    for name, value in zip(OF_AN_ENTRY, (0x109A, delay, phase, 0x0002), strict=True)
)
_COUNTER_LIST = (
    *(("TRIG", 0x0000), ("STATUS", 0x0000), ("CSICFG", 0x0080), ("PIFCCFG", 0x1050), ("PIFTCFG", 0x0000)),
    *(("BINCFG", 0x0005), ("ROICMINREG", 0x0010), ("ROICMAXREG", 0x014F), ("ROIRMINREG", 0x0018)),
    *(("ROIRMAXREG", 0x0107), ("ROS1", 0x0006), ("ROS2", 0x0060), ("IFDEL", 0x4088), ("CTRLSEQ", 0x0003)),
    *(("EXPCFG1", 0x0380), ("EXPCFG2", 0x000F), ("EXPCFG3", 0x1E0A), ("EXPCFG4", 0x1C05), ("PSOUT", 0x0313)),
    *(("PLLCFG1_LUT1", 0x466D), ("PLLCFG2_LUT1", 0xEC4F), ("PLLCFG3_LUT1", 0x0BC4)),
    *(("PLLCFG1_LUT2", 0x2241), ("PLLCFG2_LUT2", 0x13B2), ("PLLCFG3_LUT2", 0x03BB)),
    *(("PLLCFG1_LUT3", 0x6449), ("PLLCFG2_LUT3", 0x2762), ("PLLCFG3_LUT3", 0x03F6)),
    *(("PLLCFG1_LUT4", 0x4059), ("PLLCFG2_LUT4", 0xC4ED), ("PLLCFG3_LUT4", 0x13CE)),
)
PRINTED: tuple[tuple[str, int], ...] = (
    *((f"ANAIP_{name}", value) for name, value in _ANALOGUE_LIST),
    *((f"CFGCNT_{name}", value) for name, value in (*_SEQUENCE_LIST, *_COUNTER_LIST)),
    *(("MTCU_POWERCTRL", 0x1408), ("PIF_PIFHSIZE", 0x00A0), ("PIF_PIFVSIZE", 0x0078)),
)
"""The list that is sent before the first image (Steinbäck 2016, A.10; N-S-053)."""
