// Two parts under one plane: what joining them gains; see `plane_merging.py`.

var<workgroup> decision: u32;

// What the first invocation has found, for all.
fn agreed(yes: bool, local: u32) -> bool {
    if (local == 0u) { decision = select(0u, 1u, yes); }
    return workgroupUniformLoad(&decision) == 1u;
}

// The lower id comes first.
fn joined(one: u32, other: u32, local: u32) -> Join {
    let a = parts[one];
    let b = parts[other];
    var out = Join(vec3f(), 0.0, vec3f(), 0.0, 0.0, one | (other << 16u), a.id, b.id);
    let smaller = select(b.middle, a.middle, a.points <= b.points);
    let gap = moved(a.plane, smaller - a.middle).z - moved(b.plane, smaller - b.middle).z;
    if (agreed(abs(gap) > far_apart, local)) { return out; }
    lists = vec2u(one + 1u, other + 1u);
    let middle = joint_middle(a, b);
    let number = a.points + b.points;
    let first = fitted(moved(a.plane, middle - a.middle), middle, number, pair_steps, false, local);
    let second = fitted(moved(b.plane, middle - b.middle), middle, number, pair_steps, false, local);
    var best = first;
    if (second.value > first.value) { best = second; }
    let loss = a.value + b.value - best.value;
    let allowed = plane_penalty + plane_tolerance * min(a.value, b.value);
    if (agreed(loss >= allowed, local)) { return out; }
    let simplest = simplest_of(best, middle, number, local);
    let saved = clamp((a.numbers + b.numbers - simplest.w) / numbers_of_plane, 0.0, 1.0);
    out.plane = best.plane;
    out.value = best.value;
    out.simplest = simplest.xyz;
    out.numbers = simplest.w;
    out.gain = min(loss - allowed * saved, 0.0);
    return out;
}
