// Joins the two parts whose join gains most, and lists the pairs of what has come of them; see `plane_merging.py`. One
// workgroup. Where nothing is left to join it does nothing.

@group(0) @binding(0) var<storage, read> plane_count: array<u32>;
@group(0) @binding(1) var<storage, read_write> segments: array<Segment>;  // (capacity,)
@group(0) @binding(2) var<storage, read_write> parts: array<Part>;  // (capacity,)
@group(0) @binding(3) var<storage, read_write> meeting: array<u32>;  // (planes, planes), of slots: 1 where they meet
@group(0) @binding(4) var<storage, read_write> joins: array<Join>;  // how many, then those of pairs

var<workgroup> listed: atomic<u32>;

// The slot of the first part takes both.
fn join_parts(join: Join, keep: u32, gone: u32, id: u32) {
    let a = parts[keep];
    let b = parts[gone];
    parts[keep] = Part(
        join.plane, join.value, join.simplest, join.numbers, joint_middle(a, b), a.points + b.points, id
    );
    parts[gone].id = 0u;
    segments[segments[keep].last].next = gone + 1u;
    segments[keep].last = segments[gone].last;
}

@compute @workgroup_size(64)
fn main(@builtin(local_invocation_index) local: u32) {
    let number = plane_count[0];
    if (number < 2u) { return; }
    if (local == 0u) {
        joins[0].one = joins[0].slots;
        atomicStore(&listed, joins[0].slots);
    }
    let best = best_open(local);
    if (best == 0u) { return; }
    let keep = joins[best].slots & 0xffffu;
    let gone = joins[best].slots >> 16u;
    if (local == 0u) {
        joins[0].other++;
        join_parts(joins[best], keep, gone, number + joins[0].other);
    }
    for (var slot = local; slot < number; slot += 64u) {
        let meets = meeting[keep * number + slot] | meeting[gone * number + slot];
        if (slot != keep && slot != gone && meets == 1u && parts[slot].id != 0u) {
            meeting[keep * number + slot] = 1u;
            meeting[slot * number + keep] = 1u;
            joins[1u + atomicAdd(&listed, 1u)].slots = slot | (keep << 16u);
        }
    }
    workgroupBarrier();
    if (local == 0u) { joins[0].slots = atomicLoad(&listed); }
}
