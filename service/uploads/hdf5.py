"""The structure of an HDF5 file, before anything in it is read: what it links to, and how much it would unpack to.

Runs in the child process. A file may be built to do harm: every size is a claim, every link may lead out of the file.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np
from h5py import h5a, h5l, h5z

from service.uploads.errors import UploadContentError, UploadSizeError
from service.uploads.limits import MIB, Limits

FILTERS = {h5z.FILTER_DEFLATE, h5z.FILTER_SHUFFLE, h5z.FILTER_FLETCHER32, h5z.FILTER_LZF}
"""Others are programs that a file could ask for by number."""
KINDS = "iufcbSUO"
"""numpy's letters of numbers and text; O is text or a reference in the way h5py shows it."""


@dataclass
class _Tally:
    """What was seen so far."""

    objects: int = 0
    attributes: int = 0
    references: int = 0
    decoded_bytes: int = 0


def decoded_bytes(file: h5py.File, limits: Limits) -> int:
    """Bytes that all datasets unpack to.

    Raises
    ------
    UploadContentError
        A soft or external link, external or virtual storage, an unknown filter, a type that an experiment never has,
        too many or too deeply nested objects.
    UploadSizeError
        More than the limits allow, or packed so tightly that it was made to be large.
    """
    tally = _Tally()
    seen: set[object] = set()
    stack: list[tuple[h5py.Group, str, int]] = [(file["/"], "", 0)]
    _attributes(file["/"], "/", tally, limits)
    while stack:
        group, where, depth = stack.pop()
        if depth > limits.depth:
            raise UploadContentError(f"{where} lies more than {limits.depth} groups deep; an experiment needs 2")
        if len(group) > limits.objects - tally.objects:
            raise UploadContentError(f"{where or '/'} holds {len(group)} objects; at most {limits.objects} are read")
        for raw in group.id:
            name = raw.decode("utf-8", "replace")
            path = f"{where}/{name}"
            _hard_link(group, raw, path)
            node = group[raw]
            tally.objects += 1
            address = h5py.h5o.get_info(node.id).addr
            if address in seen:  # a second name, or a circle
                continue
            seen.add(address)
            _attributes(node, path, tally, limits)
            if isinstance(node, h5py.Dataset):
                _dataset(node, path, tally, limits)
            elif isinstance(node, h5py.Group):
                stack.append((node, path, depth + 1))
            else:
                raise UploadContentError(f"{path} is neither a group nor a dataset; leave it out")
    return tally.decoded_bytes


def _hard_link(group: h5py.Group, name: bytes, path: str) -> None:
    kind = group.id.links.get_info(name).type
    if kind == h5l.TYPE_EXTERNAL:
        raise UploadContentError(f"{path} is a link into another file; an upload must hold its data itself")
    if kind != h5l.TYPE_HARD:
        raise UploadContentError(f"{path} is a soft link; an upload must hold its data itself: copy it there")


def _attributes(node: Any, path: str, tally: _Tally, limits: Limits) -> None:
    count = h5a.get_num_attrs(node.id)
    tally.attributes += count
    if tally.attributes > limits.objects:
        raise UploadContentError(f"{path} has {count} attributes; at most {limits.objects} are read")
    for k in range(count):
        attribute = h5a.open(node.id, index=k)
        size = attribute.get_storage_size()
        if size > limits.attribute_bytes:
            name = attribute.name.decode("utf-8", "replace")
            raise UploadSizeError(
                f"{path}: attribute {name} has {size / MIB:.1f} MiB; at most {limits.attribute_bytes / MIB:g} are read"
            )


def _dataset(node: h5py.Dataset, path: str, tally: _Tally, limits: Limits) -> None:
    plan = node.id.get_create_plist()
    if node.is_virtual:
        raise UploadContentError(f"{path} is a virtual dataset; an upload must hold its data itself: copy them there")
    if plan.get_external_count():
        raise UploadContentError(f"{path} keeps its data in another file; an upload must hold its data itself")
    for k in range(plan.get_nfilters()):
        if (number := plan.get_filter(k)[0]) not in FILTERS:
            raise UploadContentError(
                f"{path} is packed with filter {number}; only gzip, lzf, shuffle and fletcher32 are read"
            )
    _element_type(node, path, tally, limits)
    if path.endswith("/frequency_hz") and (node.size or 0) > limits.points:
        raise UploadSizeError(f"{path} has {node.size:,} points; at most {limits.points:,} of a sweep are read")
    size = int(np.prod([int(n) for n in node.shape or ()], dtype=object)) * max(1, node.id.get_type().get_size())
    tally.decoded_bytes += size
    if tally.decoded_bytes > limits.decoded_bytes:
        raise UploadSizeError(
            f"{path} has the shape {node.shape}: with it the file unpacks to {tally.decoded_bytes / MIB:,.0f} MiB; "
            f"at most {limits.decoded_bytes / MIB:,.0f} MiB are read"
        )
    stored = node.id.get_storage_size()
    if size > limits.ratio_from_bytes and size > limits.ratio * max(1, stored):
        raise UploadSizeError(
            f"{path} says that {stored} bytes unpack to {size / MIB:,.0f} MiB; measured data do not pack so tightly"
        )


def _element_type(node: h5py.Dataset, path: str, tally: _Tally, limits: Limits) -> None:
    """Numbers, text, references (of MATLAB, counted) and complex numbers that MATLAB writes as a pair."""
    try:
        kind = node.dtype
    except TypeError as error:
        raise UploadContentError(f"{path} has a type that is not read ({error}); write numbers") from error
    if kind.names is not None:
        if set(kind.names) == {"real", "imag"} and all(kind[n].kind in "iuf" for n in kind.names):
            return
        raise UploadContentError(f"{path} has records of {len(kind.names)} fields; it must hold numbers")
    if kind == h5py.ref_dtype:
        tally.references += int(node.size or 0)
        if tally.references > limits.objects:
            raise UploadContentError(f"{path} holds {node.size} references; at most {limits.objects} are followed")
    elif kind.kind not in KINDS or (kind.kind == "O" and h5py.check_string_dtype(kind) is None):
        raise UploadContentError(f"{path} has type {kind}; it must hold numbers or text")
