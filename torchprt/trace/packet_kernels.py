"""Loops that hand packets of rays to Embree, compiled by numba; rays never lie in memory but for one packet."""

from __future__ import annotations

from types import SimpleNamespace
from typing import no_type_check

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

# Rows of RTCRay<lanes> and RTCRayHit<lanes> (embree4/rtcore_ray.h), each `lanes` numbers of 4 bytes; two more than they
# have, for the instances of instances.
ORIGIN, DIRECTION, FAR, MASK, NORMAL, U, V, TRIANGLE, ROWS = 0, 4, 8, 9, 12, 15, 16, 17, 24
# As embreex has it.
FARTHEST = np.float32(1e37)
# What Embree wants of a packet, in numbers of 4 bytes.
ALIGNED = 16


@intrinsic
@no_type_check
def _call(typing, address, valid, scene, packet):
    """`rtcOccluded<lanes>` or `rtcIntersect<lanes>` at `address`. An address and not a symbol, so that what is compiled
    can be kept on disk."""

    def generate(context, builder, signature, arguments):
        pointer = ir.PointerType(ir.IntType(8))
        kind = ir.FunctionType(ir.VoidType(), [pointer] * 4)
        function = builder.inttoptr(arguments[0], kind.as_pointer())
        # No arguments of the query: rays as incoherent ones, which was faster here than the traversal of coherent ones.
        last = ir.Constant(pointer, None)
        builder.call(function, [*(builder.inttoptr(each, pointer) for each in arguments[1:]), last])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64, types.int64), generate


@njit(nogil=True)
@no_type_check
def _aligned(lanes, rows):
    memory = np.zeros((rows * lanes + ALIGNED), np.float32)
    shift = (-(memory.ctypes.data // 4)) % ALIGNED
    return memory[shift : shift + rows * lanes]


@njit(nogil=True)
@no_type_check
def _prepared(lanes):
    """A packet and which of its lanes count, with all that is the same for all rays."""
    packet = _aligned(lanes, ROWS)
    numbers = packet.view(np.int32)
    valid = _aligned(lanes, 1).view(np.int32)
    for lane in range(lanes):
        numbers[MASK * lanes + lane] = -1
    return packet, numbers, valid


@njit(nogil=True)
@no_type_check
def _stand(lanes, packet, valid, origin):
    """Puts the origin of a receiver into the packet, whose lanes all count again."""
    for axis in range(3):
        for lane in range(lanes):
            packet[(ORIGIN + axis) * lanes + lane] = origin[axis]
    for lane in range(lanes):
        valid[lane] = -1


@njit(nogil=True)
@no_type_check
def _aim(lanes, packet, valid, origins, frame, directions, places, first, count):
    """Puts the rays from `first` on into the packet, in the frame of a receiver."""
    for lane in range(lanes):
        x, y, z = directions[0, first + lane], directions[1, first + lane], directions[2, first + lane]
        packet[DIRECTION * lanes + lane] = frame[0, 0] * x + frame[1, 0] * y + frame[2, 0] * z
        packet[(DIRECTION + 1) * lanes + lane] = frame[0, 1] * x + frame[1, 1] * y + frame[2, 1] * z
        packet[(DIRECTION + 2) * lanes + lane] = frame[0, 2] * x + frame[1, 2] * y + frame[2, 2] * z
        packet[FAR * lanes + lane] = FARTHEST
    if len(origins) > 1:
        for lane in range(lanes):
            origin = origins[places[first + lane] % len(origins)]
            for axis in range(3):
                packet[(ORIGIN + axis) * lanes + lane] = origin[axis]
    if count < first + lanes:
        for lane in range(lanes):
            valid[lane] = -1 if first + lane < count else 0


@njit(nogil=True)
@no_type_check
def _gather(lanes, packet, valid, origins, directions, first):
    """Puts single rays from `first` on into the packet."""
    for lane in range(lanes):
        ray = min(first + lane, len(origins) - 1)
        valid[lane] = -1 if first + lane < len(origins) else 0
        for axis in range(3):
            packet[(ORIGIN + axis) * lanes + lane] = origins[ray, axis]
            packet[(DIRECTION + axis) * lanes + lane] = directions[ray, axis]
        packet[FAR * lanes + lane] = FARTHEST


@njit(nogil=True)
@no_type_check
def _clear(lanes, numbers):
    """Before a packet asks for hits there are none."""
    for row in range(TRIANGLE, ROWS):
        for lane in range(lanes):
            numbers[row * lanes + lane] = -1


@njit(nogil=True)
@no_type_check
def _keep(lanes, packet, numbers, lane, triangle, u, v, front, place):
    """Writes what one ray of a packet has hit to its place."""
    found = numbers[TRIANGLE * lanes + lane]
    triangle[place] = found
    if found < 0:
        u[place], v[place], front[place] = 0, 0, False
        return
    u[place], v[place] = packet[U * lanes + lane], packet[V * lanes + lane]
    facing = np.float32(0)
    for axis in range(3):
        facing += packet[(NORMAL + axis) * lanes + lane] * packet[(DIRECTION + axis) * lanes + lane]
    front[place] = facing < 0


def kernels(lanes: int, kept: bool = True) -> SimpleNamespace:
    """The loops for packets of so many rays, a constant of what is compiled and, if it is `kept`, found on disk by the
    next process:

    - `visibility(function, scene, order, origins, frames, directions, places, count, answers)` writes 1 into
      `answers [v, D]` where a ray escapes, else 0. Receivers come in their `order [v]`; `origins [v, S, 3]`,
      `frames [v, 3, 3]`; `directions [3, R]` and `places [R]`, where each stood before they were put in the order of
      packets, R = `count` rounded up to whole packets;
    - `hits(..., triangle, u, v, front)`, all `[v, D]`, the nearest hits instead;
    - `rays_visible(function, scene, origins, directions, answers)` and `rays_hit(..., triangle, u, v, front)` of single
      rays, `[E, 3]` and `[E]`.
    `function` and `scene` are addresses. All arrays are contiguous.
    Raises RuntimeError if it cannot be kept.
    """
    # `lanes` is all that they close over: numba keys what it keeps by that, and by what else were functions, which
    # differ from process to process, nothing would be found again.

    @njit(nogil=True, cache=kept)
    @no_type_check
    def visibility(function, scene, order, origins, frames, directions, places, count, answers):
        packet, _, valid = _prepared(lanes)
        for row in order:
            _stand(lanes, packet, valid, origins[row, 0])
            for first in range(0, len(places), lanes):
                _aim(lanes, packet, valid, origins[row], frames[row], directions, places, first, count)
                _call(function, valid.ctypes.data, scene, packet.ctypes.data)
                for lane in range(min(lanes, count - first)):
                    answers[row, places[first + lane]] = 0 if packet[FAR * lanes + lane] < 0 else 1

    @njit(nogil=True, cache=kept)
    @no_type_check
    def hits(function, scene, order, origins, frames, directions, places, count, triangle, u, v, front):
        packet, numbers, valid = _prepared(lanes)
        for row in order:
            _stand(lanes, packet, valid, origins[row, 0])
            for first in range(0, len(places), lanes):
                _aim(lanes, packet, valid, origins[row], frames[row], directions, places, first, count)
                _clear(lanes, numbers)
                _call(function, valid.ctypes.data, scene, packet.ctypes.data)
                for lane in range(min(lanes, count - first)):
                    _keep(lanes, packet, numbers, lane, triangle[row], u[row], v[row], front[row], places[first + lane])

    @njit(nogil=True, cache=kept)
    @no_type_check
    def rays_visible(function, scene, origins, directions, answers):
        packet, _, valid = _prepared(lanes)
        for first in range(0, len(origins), lanes):
            _gather(lanes, packet, valid, origins, directions, first)
            _call(function, valid.ctypes.data, scene, packet.ctypes.data)
            for lane in range(min(lanes, len(origins) - first)):
                answers[first + lane] = 0 if packet[FAR * lanes + lane] < 0 else 1

    @njit(nogil=True, cache=kept)
    @no_type_check
    def rays_hit(function, scene, origins, directions, triangle, u, v, front):
        packet, numbers, valid = _prepared(lanes)
        for first in range(0, len(origins), lanes):
            _gather(lanes, packet, valid, origins, directions, first)
            _clear(lanes, numbers)
            _call(function, valid.ctypes.data, scene, packet.ctypes.data)
            for lane in range(min(lanes, len(origins) - first)):
                _keep(lanes, packet, numbers, lane, triangle, u, v, front, first + lane)

    return SimpleNamespace(visibility=visibility, hits=hits, rays_visible=rays_visible, rays_hit=rays_hit)
