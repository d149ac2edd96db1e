"""The Embree that the wheel of embreex carries, called as the C library that it is."""

from __future__ import annotations

import ctypes
import ctypes.util
import functools
import importlib.metadata
import re
import weakref
from typing import Any

import numpy as np
from jaxtyping import Float32, Int32

from torchprt.trace.engines import CannotRun

# embree4/rtcore_*.h, the same in all versions from 4.0 on.
TRIANGLES, INDICES, VERTICES, UINT3, FLOAT3, ROBUST = 0, 0, 1, 0x5003, 0x9003, 1 << 2
VERSION, RAY4, RAY8, RAY16, CULLING = 0, 32, 33, 34, 65
_LIBRARY = re.compile(r"^(lib)?embree4.*(\.so(\.\d+)*|\.dylib|\.dll)$")
_POINTER = ctypes.c_void_p
_FUNCTIONS: dict[str, tuple[object, list[object]]] = {
    "rtcNewDevice": (_POINTER, [ctypes.c_char_p]),
    "rtcReleaseDevice": (None, [_POINTER]),
    "rtcGetDeviceProperty": (ctypes.c_ssize_t, [_POINTER, ctypes.c_int]),
    "rtcGetDeviceError": (ctypes.c_int, [_POINTER]),
    "rtcNewScene": (_POINTER, [_POINTER]),
    "rtcReleaseScene": (None, [_POINTER]),
    "rtcSetSceneFlags": (None, [_POINTER, ctypes.c_int]),
    "rtcCommitScene": (None, [_POINTER]),
    "rtcNewGeometry": (_POINTER, [_POINTER, ctypes.c_int]),
    "rtcSetNewGeometryBuffer": (
        _POINTER,
        [_POINTER, ctypes.c_int, ctypes.c_uint, ctypes.c_int, ctypes.c_size_t, ctypes.c_size_t],
    ),
    "rtcCommitGeometry": (None, [_POINTER]),
    "rtcAttachGeometry": (ctypes.c_uint, [_POINTER, _POINTER]),
    "rtcReleaseGeometry": (None, [_POINTER]),
}
_PACKETS = [f"rtc{what}{lanes}" for what in ("Occluded", "Intersect") for lanes in (4, 8, 16)]


def _path() -> str:
    try:
        files = importlib.metadata.files("embreex") or []
    except importlib.metadata.PackageNotFoundError as fault:
        raise CannotRun("embreex is not installed") from fault
    for file in files:
        if _LIBRARY.match(file.name):
            return str(file.locate())
    found = ctypes.util.find_library("embree4")
    if found is None:
        raise CannotRun("there is no library of Embree 4 beside embreex")
    return found


class Embree:
    """Functions and a device of the library at `path`. `settings`: those of `rtcNewDevice`, such as "isa=avx2".

    Raises CannotRun if the library is none of Embree 4, or lacks what packets need.
    """

    def __init__(self, path: str, settings: str = "") -> None:
        self.path = path
        try:
            self._library = ctypes.CDLL(path)
        except OSError as fault:
            raise CannotRun(f"{path} cannot be loaded ({fault})") from fault
        for name, (result, arguments) in _FUNCTIONS.items():
            self._symbol(name).restype, self._symbol(name).argtypes = result, arguments
        self.addresses = {name: ctypes.cast(self._symbol(name), _POINTER).value or 0 for name in _PACKETS}
        self.device = self.call("rtcNewDevice", settings.encode())
        if not self.device:
            raise CannotRun(f"{path} makes no device")
        weakref.finalize(self, self._library.rtcReleaseDevice, self.device)
        version = self.property(VERSION)
        self.version = f"{version // 10000}.{version // 100 % 100}.{version % 100}"
        if version // 10000 != 4:
            raise CannotRun(f"{path} is Embree {self.version}, packets are made for Embree 4")
        if self.property(CULLING):
            raise CannotRun(f"{path} was built to cull back faces")
        native = {16: RAY16, 8: RAY8, 4: RAY4}
        self.lanes = next((lanes for lanes, name in native.items() if self.property(name)), 0)
        if not self.lanes:
            raise CannotRun(f"{path} has no packets of rays on this processor")

    def _symbol(self, name: str) -> ctypes._CFuncPtr:
        try:
            return getattr(self._library, name)
        except AttributeError as fault:
            raise CannotRun(f"{self.path} has no function {name}") from fault

    def call(self, name: str, *arguments: object) -> Any:
        """What a function of the library returns."""
        return self._symbol(name)(*arguments)

    def property(self, number: int) -> int:
        """A property of the device."""
        return self.call("rtcGetDeviceProperty", self.device, number)


class Triangles:
    """A scene of triangles in robust mode, its tree built; `pointer` for the functions that trace."""

    def __init__(self, embree: Embree, vertices: Float32[np.ndarray, "V 3"], faces: Int32[np.ndarray, "F 3"]) -> None:
        self._embree = embree
        scene = embree.call("rtcNewScene", embree.device)
        self.pointer = scene
        self._end = weakref.finalize(self, embree.call, "rtcReleaseScene", scene)
        embree.call("rtcSetSceneFlags", scene, ROBUST)
        geometry = embree.call("rtcNewGeometry", embree.device, TRIANGLES)
        for slot, form, array in ((VERTICES, FLOAT3, vertices), (INDICES, UINT3, faces)):
            # Embree's own copy: it asks for bytes to read beyond the last vertex, and frees it itself.
            array = np.ascontiguousarray(array)
            buffer = embree.call("rtcSetNewGeometryBuffer", geometry, slot, 0, form, 12, len(array))
            if not buffer:
                raise MemoryError(f"Embree has no memory for {len(faces)} triangles")
            ctypes.memmove(buffer, array.ctypes.data, array.nbytes)
        embree.call("rtcCommitGeometry", geometry)
        embree.call("rtcAttachGeometry", scene, geometry)
        embree.call("rtcReleaseGeometry", geometry)
        embree.call("rtcCommitScene", scene)
        fault = embree.call("rtcGetDeviceError", embree.device)
        if fault:
            raise MemoryError(f"Embree cannot build a tree of {len(faces)} triangles (its error {fault})")


@functools.cache
def library() -> Embree:
    """The library of embreex. Raises CannotRun as `Embree`."""
    return Embree(_path())
