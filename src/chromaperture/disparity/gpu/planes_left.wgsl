// The planes that are left when neighbours have been joined, in the order of their parts; see `plane_merging.py`. One
// workgroup. Notes where another join would follow: there were fewer rounds than joins.

@group(0) @binding(0) var<storage, read_write> segments: array<Segment>;  // (capacity,)
@group(0) @binding(1) var<storage, read> parts: array<Part>;  // (capacity,)
@group(0) @binding(2) var<storage, read> joins: array<Join>;  // how many, then those of pairs
@group(0) @binding(3) var<storage, read_write> planes: array<vec4f>;  // (capacity,): layers, cost of the slope
@group(0) @binding(4) var<storage, read_write> plane_count: array<u32>;
@group(0) @binding(5) var<storage, read_write> unfinished: array<u32>;  // how often

var<workgroup> before: u32;
var<workgroup> left: atomic<u32>;

@compute @workgroup_size(64)
fn main(@builtin(local_invocation_index) local: u32) {
    if (local == 0u) {
        before = plane_count[0];
        atomicStore(&left, 0u);
    }
    let number = workgroupUniformLoad(&before);
    if (number < 2u) { return; }
    let following = best_open(local);
    if (local == 0u && following != 0u) { unfinished[0]++; }
    for (var slot = local; slot < number; slot += 64u) {
        let part = parts[slot];
        var rank = 0u;
        for (var other = 0u; other < number; other++) {
            let id = parts[other].id;
            rank += select(0u, 1u, id != 0u && id < part.id);
        }
        var next = 0u;
        if (part.id != 0u) {
            let slope = part.simplest.xy;
            planes[rank] = vec4f(moved(part.simplest, -part.middle), 0.5 * slope_penalty * dot(slope, slope));
            atomicAdd(&left, 1u);
            next = slot + 1u;
        }
        while (next != 0u) {
            segments[next - 1u].last = rank;
            next = segments[next - 1u].next;
        }
    }
    workgroupBarrier();
    if (local == 0u) { plane_count[0] = atomicLoad(&left); }
}
