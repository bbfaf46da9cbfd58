# mypy: disallow-untyped-defs=False
"""The exponential window of the compiled matcher, eight layers of a pixel in a vector.

Along x both recursions run at once over a group of rows; along y the downward recursion follows in the ring of rows,
the upward one in a single row of state. They are kept without their gains, f = x + a f; the product of the gains is
made good once, by whoever uses the result.
"""

from __future__ import annotations

from chromaperture.matching.compiled import simd as v
from chromaperture.matching.compiled.layout import ONE, inner


@inner
def copy(source, at, target, to, count):
    """Copy ``count`` elements, a multiple of eight."""
    for i in range(0, count, v.LANES):
        v.store(target, to + i, v.load(source, at + i))


@inner
def window_rows(a, ia, step_a, down_a, b, ib, step_b, down_b, ring, at, width, decay, begin):
    """Window the products of four rows: along x both ways, along y downwards from the rows above in the ring."""
    decay8 = v.broadcast(decay)
    border_gain = v.broadcast(ONE / (ONE - decay))
    last_x = v.broadcast(decay / ((ONE + decay) * (ONE - decay) * (ONE - decay)))
    last_f = v.broadcast(ONE / ((ONE + decay) * (ONE - decay)))
    down = width * v.LANES
    a1, a2, a3, b1, b2, b3 = down_a, 2 * down_a, 3 * down_a, down_b, 2 * down_b, 3 * down_b
    r1, r2, r3 = down, 2 * down, 3 * down
    f0 = v.mul(border_gain, v.mul(v.load(a, ia), v.load(b, ib)))
    f1 = v.mul(border_gain, v.mul(v.load(a, ia + a1), v.load(b, ib + b1)))
    f2 = v.mul(border_gain, v.mul(v.load(a, ia + a2), v.load(b, ib + b2)))
    f3 = v.mul(border_gain, v.mul(v.load(a, ia + a3), v.load(b, ib + b3)))
    v.store(ring, at, f0)
    v.store(ring, at + r1, f1)
    v.store(ring, at + r2, f2)
    v.store(ring, at + r3, f3)
    for _ in range(width - 1):
        ia, ib, at = ia + step_a, ib + step_b, at + v.LANES
        f0 = v.fma(decay8, f0, v.mul(v.load(a, ia), v.load(b, ib)))
        f1 = v.fma(decay8, f1, v.mul(v.load(a, ia + a1), v.load(b, ib + b1)))
        f2 = v.fma(decay8, f2, v.mul(v.load(a, ia + a2), v.load(b, ib + b2)))
        f3 = v.fma(decay8, f3, v.mul(v.load(a, ia + a3), v.load(b, ib + b3)))
        v.store(ring, at, f0)
        v.store(ring, at + r1, f1)
        v.store(ring, at + r2, f2)
        v.store(ring, at + r3, f3)
    f0 = v.fma(last_f, f0, v.mul(last_x, v.mul(v.load(a, ia), v.load(b, ib))))
    f1 = v.fma(last_f, f1, v.mul(last_x, v.mul(v.load(a, ia + a1), v.load(b, ib + b1))))
    f2 = v.fma(last_f, f2, v.mul(last_x, v.mul(v.load(a, ia + a2), v.load(b, ib + b2))))
    f3 = v.fma(last_f, f3, v.mul(last_x, v.mul(v.load(a, ia + a3), v.load(b, ib + b3))))
    for x in range(width):
        if x > 0:
            f0 = v.fma(decay8, f0, v.load(ring, at))
            f1 = v.fma(decay8, f1, v.load(ring, at + r1))
            f2 = v.fma(decay8, f2, v.load(ring, at + r2))
            f3 = v.fma(decay8, f3, v.load(ring, at + r3))
        column = v.mul(border_gain, f0) if begin else v.fma(decay8, v.load(ring, at - down), f0)
        v.store(ring, at, column)
        column = v.fma(decay8, column, f1)
        v.store(ring, at + r1, column)
        column = v.fma(decay8, column, f2)
        v.store(ring, at + r2, column)
        column = v.fma(decay8, column, f3)
        v.store(ring, at + r3, column)
        at -= v.LANES


@inner
def window_end(ring, at, rows, width, decay, state, at_state):
    """Start the upward recursion at the last row, which continues for ever."""
    decay8 = v.broadcast(decay)
    last_x = v.broadcast(decay / ((ONE + decay) * (ONE - decay) * (ONE - decay)))
    last_f = v.broadcast(ONE / ((ONE + decay) * (ONE - decay)))
    below = at + (rows - 1) * width * v.LANES
    above = below - width * v.LANES
    for i in range(0, width * v.LANES, v.LANES):
        f = v.load(ring, below + i)
        x = v.fnma(decay8, v.load(ring, above + i), f)
        v.store(state, at_state + i, v.fma(last_f, f, v.mul(last_x, x)))


@inner
def window_up(ring, at, width, decay, state, at_state):
    """Carry the upward recursion past one row."""
    decay8 = v.broadcast(decay)
    for i in range(0, width * v.LANES, v.LANES):
        v.store(state, at_state + i, v.fma(decay8, v.load(state, at_state + i), v.load(ring, at + i)))
