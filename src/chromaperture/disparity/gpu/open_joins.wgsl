// The best of the joins that are open: both of their parts are still there; see `plane_merging.py`.

var<workgroup> chosen: array<u32, 64>;

fn is_open(at: u32) -> bool {
    let join = joins[at];
    let ids = vec2u(parts[join.slots & 0xffffu].id, parts[join.slots >> 16u].id);
    return join.gain < 0.0 && ids.x == join.one && ids.y == join.other;
}

// The better of two joins, 0 for none; equal ones in the order of their parts.
fn better(a: u32, b: u32) -> u32 {
    if (a == 0u || b == 0u) { return max(a, b); }
    let one = joins[a];
    let other = joins[b];
    let lower = one.one < other.one || (one.one == other.one && one.other < other.other);
    return select(b, a, one.gain < other.gain || (one.gain == other.gain && lower));
}

// Of all invocations; 0 for none.
fn best_open(local: u32) -> u32 {
    let listed = joins[0].slots;
    var own = 0u;
    for (var i = 1u + local; i <= listed; i += 64u) {
        if (is_open(i)) { own = better(i, own); }
    }
    chosen[local] = own;
    workgroupBarrier();
    for (var half = 32u; half > 0u; half /= 2u) {
        if (local < half) { chosen[local] = better(chosen[local], chosen[local + half]); }
        workgroupBarrier();
    }
    return workgroupUniformLoad(&chosen[0]);
}
