// What the pairs that were listed last would gain if they were joined; so many pairs side by side.

@group(0) @binding(0) var<storage, read> likelihood: array<f32>;  // (h, w, count), of blocks
@group(0) @binding(1) var<storage, read> points: array<u32>;  // x and y, 16 bits each
@group(0) @binding(2) var<storage, read> segments: array<Segment>;  // (capacity,)
@group(0) @binding(3) var<storage, read> parts: array<Part>;  // (capacity,)
@group(0) @binding(4) var<storage, read_write> joins: array<Join>;  // how many, then those of every pair

var<workgroup> listed: vec2u;

@compute @workgroup_size(lanes)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    if (local == 0u) { listed = vec2u(joins[0].one, joins[0].slots); }
    let range = workgroupUniformLoad(&listed);
    for (var i = 1u + range.x + group.x; i <= range.y; i += side_by_side) {
        let slots = joins[i].slots;
        let found = joined(slots & 0xffffu, slots >> 16u, local);
        if (local == 0u) { joins[i] = found; }
    }
}
