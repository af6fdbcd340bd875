"""Where each object lives in the CANopen object dictionary, and the EDS file.

=============  ===========================================================================================
0x2000 + k     record of group k: sub-index 1 and on, one object each, for any CANopen tool
0x2100 + k     the same group whole, a DOMAIN, little-endian: one atomic transfer
0x2200         lock-in payload of the last result, DOMAIN
0x2201         raw record of the last result, DOMAIN
RPDO 1         heartbeat: token, count          COB-ID 0x200 + node
RPDO 2         stop: token                      COB-ID 0x300 + node
TPDO 1         command, state, outcome          COB-ID 0x180 + node, when a tone begins and ends
EMCY           on a trip                        COB-ID 0x080 + node
=============  ===========================================================================================

Stop and heartbeat are never SDOs: the upload of a raw record holds the SDO channel for seconds.
"""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass

from canopen import ObjectDictionary
from canopen.objectdictionary import ODRecord, ODVariable, datatypes
from canopen.objectdictionary.eds import export_eds

from drivers.objects import GROUPS, PROTOCOL_VERSION, Group, Object, Type

RECORD_INDEX = 0x2000
WHOLE_INDEX = 0x2100
LOCKIN_INDEX = 0x2200
RAW_INDEX = 0x2201

_TYPES = {
    Type.U16: datatypes.UNSIGNED16,
    Type.U32: datatypes.UNSIGNED32,
    Type.I32: datatypes.INTEGER32,
    Type.F32: datatypes.REAL32,
    Type.F64: datatypes.REAL64,
    Type.TEXT: datatypes.VISIBLE_STRING,
}


@dataclass(frozen=True)
class SubObject:
    """One sub-index: an object, or one value of an object that holds several."""

    index: int
    subindex: int
    group: Group
    obj: Object
    element: int | None
    """Which value of the object; None for a text or a single value."""

    @property
    def name(self) -> str:
        """Name in the EDS."""
        return self.obj.name if self.element is None else f"{self.obj.name}_{self.element}"


def sub_objects(group: Group) -> tuple[SubObject, ...]:
    """Sub-indices of a group's record, in order."""
    found: list[SubObject] = []
    for obj in group.objects:
        elements = [None] if obj.type is Type.TEXT or obj.count == 1 else list(range(obj.count))
        for element in elements:
            found.append(SubObject(RECORD_INDEX + group.index, len(found) + 1, group, obj, element))
    return tuple(found)


def object_dictionary(node_id: int = 1) -> ObjectDictionary:
    """Object dictionary of a controller, with limits, factors and units."""
    od = ObjectDictionary()  # type: ignore[no-untyped-call]
    od.node_id = node_id
    od.device_information.vendor_name = "AMB commissioning"
    od.device_information.product_name = f"Magnetic bearing controller, protocol {PROTOCOL_VERSION}"
    od.device_information.allowed_baudrates = {125e3, 250e3, 500e3, 1000e3}
    od.device_information.nr_of_RXPDO = 2  # type: ignore[assignment]
    od.device_information.nr_of_TXPDO = 1  # type: ignore[assignment]
    od.add_object(_variable("Device type", 0x1000, 0, datatypes.UNSIGNED32, "ro", default=0))
    od.add_object(_variable("Error register", 0x1001, 0, datatypes.UNSIGNED8, "ro", default=0))
    od.add_object(_variable("Producer heartbeat time", 0x1017, 0, datatypes.UNSIGNED16, "rw", default=0))
    od.add_object(_record("Identity object", 0x1018, [("Vendor-ID", datatypes.UNSIGNED32, 0)]))
    for number, (cob_id, mapped) in enumerate(((0x200, _mapping("beat", 2)), (0x300, _mapping("stop", 1)))):
        _add_pdo(od, "RPDO", 0x1400 + number, 0x1600 + number, cob_id + node_id, mapped)
    status = [0x2001_0000 | (s.subindex << 8) | 8 * s.obj.size for s in sub_objects(GROUPS[1]) if s.name in _TPDO]
    _add_pdo(od, "TPDO", 0x1800, 0x1A00, 0x180 + node_id, status)
    for group in GROUPS:
        od.add_object(_group_record(group))
        od.add_object(_variable(f"{group.name} whole", WHOLE_INDEX + group.index, 0, datatypes.DOMAIN, group.access))
    od.add_object(_variable("lock-in payload", LOCKIN_INDEX, 0, datatypes.DOMAIN, "ro"))
    od.add_object(_variable("raw record", RAW_INDEX, 0, datatypes.DOMAIN, "ro"))
    return od


def eds(node_id: int = 1) -> str:
    """EDS file of a controller; the same text whenever it is made."""
    text = io.StringIO()
    info = {
        "FileName": "amb.eds", "FileVersion": PROTOCOL_VERSION, "FileRevision": 0, "EdsVersion": "4.0",
        "Description": "Magnetic bearing controller", "CreationDate": "01-01-2026", "CreationTime": "12:00AM",
        "CreatedBy": "ambit", "ModificationDate": "01-01-2026", "ModificationTime": "12:00AM",
    }  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # canopen asks for the time in a deprecated way
        export_eds(object_dictionary(node_id), text, info)  # type: ignore[no-untyped-call]
    return text.getvalue()


_TPDO = ("command", "state", "outcome")


def _mapping(group: str, count: int) -> list[int]:
    of = next(g for g in GROUPS if g.name == group)
    return [(s.index << 16) | (s.subindex << 8) | 8 * s.obj.size for s in sub_objects(of)[:count]]


def _variable(
    name: str, index: int, subindex: int, data_type: int, access: str, default: int | None = None
) -> ODVariable:
    variable = ODVariable(name, index, subindex)
    variable.data_type = data_type
    variable.access_type = access
    variable.default = default
    return variable


def _record(name: str, index: int, members: list[tuple[str, int, int]]) -> ODRecord:
    record = ODRecord(name, index)
    record.add_member(_variable("Highest sub-index", index, 0, datatypes.UNSIGNED8, "const", default=len(members)))
    for k, (member, data_type, default) in enumerate(members, 1):
        record.add_member(_variable(member, index, k, data_type, "ro", default))
    return record


def _add_pdo(od: ObjectDictionary, kind: str, communication: int, mapping: int, cob_id: int, mapped: list[int]) -> None:
    number = (communication & 0xFF) + 1
    od.add_object(
        _record(
            f"{kind} {number} communication",
            communication,
            [("COB-ID", datatypes.UNSIGNED32, cob_id), ("Transmission type", datatypes.UNSIGNED8, 255)],
        )
    )
    members = [(f"Object {k}", datatypes.UNSIGNED32, entry) for k, entry in enumerate(mapped, 1)]
    od.add_object(_record(f"{kind} {number} mapping", mapping, members))


def _group_record(group: Group) -> ODRecord:
    record = ODRecord(group.name, RECORD_INDEX + group.index)
    subs = sub_objects(group)
    record.add_member(_variable("Highest sub-index", record.index, 0, datatypes.UNSIGNED8, "const", default=len(subs)))
    for sub in subs:
        obj = sub.obj
        variable = _variable(sub.name, sub.index, sub.subindex, _TYPES[obj.type], group.access)
        variable.description = obj.description
        variable.unit = obj.unit
        variable.factor = 1 / obj.per_unit
        if obj.type in (Type.U16, Type.U32, Type.I32):
            variable.min = None if obj.low is None else round(obj.low * obj.per_unit)
            variable.max = None if obj.high is None else round(obj.high * obj.per_unit)
        variable.pdo_mappable = obj.size <= 8
        record.add_member(variable)
    return record
