"""Adaptive shading of a layer one receiver after the other, as the algorithms of the paper are written."""

import math

import torch


def neighbours_of(faces, count):
    """The set of receivers that share an edge with each."""
    found = [set() for _ in range(count)]
    for face in faces.tolist():
        for a, b in zip(face, face[1:] + face[:1], strict=True):
            if a != b:
                found[a].add(b)
                found[b].add(a)
    return found


def adapted(radiance, weight, orders, threshold, faces=None, against="last", rings=2, grow=True):
    """Radiance `[G, 3]` and the order of each receiver, of `radiance[level] [G, 3]` at every order.

    The result includes the `weight [G, 3]`, the radiance that is given does not.

    Hard regions: a receiver is in from the threshold on.
    """
    count = len(radiance[0])
    beside = neighbours_of(faces, count) if faces is not None else [set() for _ in range(count)]
    shown = [radiance[0][g].clone() for g in range(count)]
    level_of = [0] * count
    if len(orders) == 1 or math.isinf(threshold):
        return torch.stack(shown) * weight, [orders[0]] * count

    def difference(g, level):
        below = shown[g] if against == "last" else radiance[0][g]
        return float(((radiance[level][g] - below) * weight[g]).abs().max())

    changed = [0.0] * count
    for g in range(count):
        changed[g], level_of[g] = difference(g, 1), 1
        shown[g] = radiance[1][g].clone()
    inside, region = set(range(count)), set()
    for level in range(2, len(orders)):
        chosen = {g for g in inside if changed[g] >= threshold}
        if not chosen:
            break
        now = {}
        for g in chosen:
            now[g] = difference(g, level)
        evaluated, queue, members = set(chosen), [g for g in chosen if now[g] >= threshold], set(chosen)
        while grow and queue:
            for h in sorted(beside[queue.pop(0)] - evaluated):
                evaluated.add(h)
                now[h] = difference(h, level)
                if now[h] >= threshold:
                    members.add(h)
                    queue.append(h)
        for g in evaluated:
            level_of[g], changed[g] = level, now[g]
        for g in members:
            shown[g] = radiance[level][g].clone()
        inside = members
        region |= members
    own = [shown[g] - radiance[1][g] for g in range(count)]
    added = own
    for _ in range(rings):
        means = [sum(added[h] for h in beside[g]) / max(len(beside[g]), 1) for g in range(count)]
        added = [own[g] if g in region else own[g] + means[g] for g in range(count)]
    result = torch.stack([radiance[1][g] + added[g] for g in range(count)])
    return result * weight, [orders[level] for level in level_of]
