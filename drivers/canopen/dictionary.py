"""The CANopen object dictionary of a controller, and its EDS file."""

from __future__ import annotations

import io
import warnings

from canopen import ObjectDictionary
from canopen.objectdictionary import ODRecord, ODVariable, datatypes
from canopen.objectdictionary.eds import export_eds

from drivers.canopen.map import (
    DEFAULT_MAP,
    PROGRESS_OBJECTS,
    RECORD_INDEX,
    WHOLE_INDEX,
    ObjectMap,
    SubObject,
)
from drivers.objects import GROUPS, PROTOCOL_VERSION, Type

_TYPES = {
    Type.U16: datatypes.UNSIGNED16,
    Type.U32: datatypes.UNSIGNED32,
    Type.I32: datatypes.INTEGER32,
    Type.F32: datatypes.REAL32,
    Type.F64: datatypes.REAL64,
    Type.TEXT: datatypes.VISIBLE_STRING,
}


def object_dictionary(node_id: int = 1, objects: ObjectMap = DEFAULT_MAP) -> ObjectDictionary:
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
    beat, stop = _mapping(objects, "beat", ("token", "count")), _mapping(objects, "stop", ("token",))
    _add_pdo(od, "RPDO", 0x1400, 0x1600, objects.beat_cob_id + node_id, beat)
    _add_pdo(od, "RPDO", 0x1401, 0x1601, objects.stop_cob_id + node_id, stop)
    progress = _mapping(objects, "status", PROGRESS_OBJECTS)
    _add_pdo(od, "TPDO", 0x1800, 0x1A00, objects.progress_cob_id + node_id, progress)
    for group in GROUPS:
        for index in dict.fromkeys(s.index for s in objects.of(group.name)):
            if index not in od:
                _add_objects(od, index, [s for s in objects.subs if s.index == index])
        if group.name in objects.whole:
            whole = WHOLE_INDEX + group.index
            od.add_object(_variable(f"{group.name} whole", whole, 0, datatypes.DOMAIN, group.access))
    od.add_object(_variable("lock-in payload", objects.lockin_index, 0, datatypes.DOMAIN, "ro"))
    od.add_object(_variable("raw record", objects.raw_index, 0, datatypes.DOMAIN, "ro"))
    od.add_object(_variable("raw record, segment", objects.segment_index, 0, datatypes.DOMAIN, "ro"))
    return od


def eds(node_id: int = 1, objects: ObjectMap = DEFAULT_MAP) -> str:
    """EDS file of a controller; the same text whenever it is made."""
    text = io.StringIO()
    info = {
        "FileName": "amb.eds", "FileVersion": PROTOCOL_VERSION, "FileRevision": 0, "EdsVersion": "4.0",
        "Description": "Magnetic bearing controller", "CreationDate": "01-01-2026", "CreationTime": "12:00AM",
        "CreatedBy": "ambit", "ModificationDate": "01-01-2026", "ModificationTime": "12:00AM",
    }  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # canopen asks for the time in a deprecated way
        export_eds(object_dictionary(node_id, objects), text, info)  # type: ignore[no-untyped-call]
    return text.getvalue()


def _mapping(objects: ObjectMap, group: str, names: tuple[str, ...]) -> list[int]:
    """Entries of a PDO mapping: index, sub-index, bits."""
    return [(s.index << 16) | (s.subindex << 8) | 8 * s.size for s in objects.of(group) if s.name in names]


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


def _add_objects(od: ObjectDictionary, index: int, subs: list[SubObject]) -> None:
    """A record of these sub-indices, or a variable when it is sub-index 0."""
    if subs[0].subindex == 0:
        od.add_object(_of_sub(subs[0]))
        return
    highest = max(s.subindex for s in subs)
    name = subs[0].group.name if index == RECORD_INDEX + subs[0].group.index else f"record {index:04X}"
    record = ODRecord(name, index)
    record.add_member(_variable("Highest sub-index", index, 0, datatypes.UNSIGNED8, "const", default=highest))
    for sub in subs:
        record.add_member(_of_sub(sub))
    od.add_object(record)


def _of_sub(sub: SubObject) -> ODVariable:
    obj = sub.obj
    variable = _variable(sub.name, sub.index, sub.subindex, _TYPES[obj.type], sub.group.access)
    variable.description = obj.description
    variable.unit = obj.unit
    variable.factor = 1 / obj.per_unit
    if obj.type in (Type.U16, Type.U32, Type.I32):
        variable.min = None if obj.low is None else round(obj.low * obj.per_unit)
        variable.max = None if obj.high is None else round(obj.high * obj.per_unit)
    variable.pdo_mappable = obj.size <= 8
    return variable
