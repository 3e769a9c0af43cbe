# SPDX-License-Identifier: Apache-2.0
"""Messages of other ROS versions as ROS 2 Jazzy defines them: ROS 1, and types that have got further fields since.

Nothing is guessed: a type may lack only fields that no shadow depends on, and have beyond Jazzy's only the sequence
number of ROS 1's header. A grid map of ROS 1 has its header in its info.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import zstandard
from rosbags.convert.converter import migrate_message
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from shadow_tracer.apps.bag.files import ZSTD
from shadow_tracer.ros.wire.grid_map import DEFINITIONS, GRID_MAP, GRID_MAP_INFO
from shadow_tracer.ros.wire.messages import MessageError

USUAL = get_typestore(Stores.ROS2_JAZZY)
for _name, _text in DEFINITIONS.items():  # which Jazzy's standard packages have not
    USUAL.register(get_types_from_msg(_text, _name))
Convert = Callable[[bytes], bytes]

_HEADER = "std_msgs/msg/Header"
_RENAMED = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}
_MAY_LACK = {"visualization_msgs/msg/Marker": {"texture_resource", "texture", "uv_coordinates", "mesh_file"}}
_MAY_HAVE = {_HEADER: {"seq"}}


def usual_name(kind: str) -> str:
    """What ROS 2 calls a type of a bag."""
    return _RENAMED.get(kind, kind)


class Types:
    """The message types of one file.

    Args:
        store: they, as rosbags has read them.
        is2: whether messages are serialised as in ROS 2.
    """

    def __init__(self, store: Any, is2: bool) -> None:
        self.store = store
        self.is2 = is2
        self._cache: dict[str, Any] = {}
        self._own: Any = None

    def converter(self, kind: str) -> Convert | None:
        """How bytes of a type become those of Jazzy's type; None if that type is another or unknown.

        The result raises MessageError where bytes are not such a message.
        """
        usual = usual_name(kind)
        if kind not in self.store.fielddefs or usual not in USUAL.fielddefs:
            return None
        if kind == GRID_MAP and not self.is2 and self._has_header_in_info():
            return partial(_guarded, kind, self._grid_map)
        if self._same(kind, usual):
            return partial(_guarded, kind, _plain if self.is2 else partial(USUAL.ros1_to_cdr, typename=usual))
        return partial(_guarded, kind, partial(self._migrate, kind, usual)) if self._fits(kind, usual) else None

    def is_plain(self, kind: str) -> bool:
        """Whether bytes of a type are those of Jazzy's type as they are, so that some of them can be read alone."""
        usual = usual_name(kind)
        return self.is2 and kind in self.store.fielddefs and usual in USUAL.fielddefs and self._same(kind, usual)

    def copier(self, kind: str) -> tuple[Convert, Any]:
        """How bytes of any type become those of a new bag, and the types that define them there."""
        if self.is2:
            return partial(_guarded, kind, _plain), self.store if kind in self.store.fielddefs else USUAL
        if convert := self.converter(kind):
            return convert, USUAL
        if self._own is None:
            self._own = get_typestore(Stores.EMPTY)
            self._own.register({**self.store.fielddefs, _HEADER: USUAL.fielddefs[_HEADER]})
        return partial(_guarded, kind, partial(self._own.ros1_to_cdr, typename=kind)), self._own

    def _same(self, kind: str, usual: str) -> bool:
        """Whether the bytes of both are laid out alike, up to the header of ROS 1."""
        if not self.is2 and usual == _HEADER:
            return True
        ours, theirs = USUAL.fielddefs[usual][1], self.store.fielddefs.get(kind, ((), ()))[1]
        return len(ours) == len(theirs) and all(
            mine[0].lower() == other[0].lower() and self._alike(other[1], mine[1], self._same)
            for mine, other in zip(ours, theirs, strict=True)
        )

    def _fits(self, kind: str, usual: str) -> bool:
        """Whether a message has all fields that count, and none beyond."""
        ours = {name.lower(): field for name, field in USUAL.fielddefs[usual][1]}
        theirs = {name.lower(): field for name, field in self.store.fielddefs.get(kind, ((), ()))[1]}
        return (
            ours.keys() - theirs.keys() <= _MAY_LACK.get(usual, set())
            and theirs.keys() - ours.keys() <= _MAY_HAVE.get(usual, set())
            and all(self._alike(theirs[name], ours[name], self._fits) for name in ours.keys() & theirs.keys())
        )

    def _alike(self, theirs: Any, ours: Any, compare: Callable[[str, str], bool]) -> bool:
        if theirs[0] != ours[0]:
            return False
        if ours[0] == Nodetype.NAME:
            return theirs[1] == ours[1] and compare(theirs[1], ours[1])
        if ours[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            return theirs[1][1] == ours[1][1] and self._alike(theirs[1][0], ours[1][0], compare)
        return bool(theirs[1] == ours[1])

    def _has_header_in_info(self) -> bool:
        """Whether a grid map is that of ROS 1."""
        for kind, add, drop in ((GRID_MAP, set(), {"header"}), (GRID_MAP_INFO, {"header"}, set())):
            ours, theirs = (dict(store.fielddefs.get(kind, ((), ()))[1]) for store in (USUAL, self.store))
            if theirs.keys() != (ours.keys() - drop) | add:
                return False
            for name in ours.keys() & theirs.keys():
                if theirs[name][1] != GRID_MAP_INFO and not self._alike(theirs[name], ours[name], self._fits):
                    return False
        return self._fits(_HEADER, _HEADER)

    def _grid_map(self, data: bytes) -> Any:
        message = self.store.deserialize_ros1(data, GRID_MAP)
        moved: Any = migrate_message(self.store, USUAL, GRID_MAP, GRID_MAP, self._cache, message)
        header = migrate_message(self.store, USUAL, _HEADER, _HEADER, self._cache, message.info.header)
        return USUAL.serialize_cdr(replace(moved, header=header), GRID_MAP)

    def _migrate(self, kind: str, usual: str, data: bytes) -> Any:
        read = self.store.deserialize_cdr if self.is2 else self.store.deserialize_ros1
        message = migrate_message(self.store, USUAL, kind, usual, self._cache, read(data, kind))
        return USUAL.serialize_cdr(message, usual)


def _plain(data: bytes) -> bytes:
    """The bytes of a ROS 2 message, which a recorder may have compressed: none begins as zstd does."""
    if data[:4] != ZSTD:
        return data
    decompressor = zstandard.ZstdDecompressor().decompressobj()
    plain = decompressor.decompress(data)
    if not decompressor.eof:
        raise ValueError("the zstd data is cut off")
    return plain


def _guarded(kind: str, convert: Callable[[bytes], Any], data: bytes) -> bytes:
    try:
        return bytes(convert(data))
    except Exception as error:  # bytes can be wrong in any way
        raise MessageError(f"message: not a {kind}: {error}") from error
