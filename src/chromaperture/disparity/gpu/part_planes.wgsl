// The part of every plane before any are joined: its plane refined, and its simplest one; see `plane_merging.py`.

@group(0) @binding(0) var<storage, read> likelihood: array<f32>;  // (h, w, count), of blocks
@group(0) @binding(1) var<storage, read> points: array<u32>;  // x and y, 16 bits each
@group(0) @binding(2) var<storage, read> segments: array<Segment>;  // (capacity,)
@group(0) @binding(3) var<storage, read> planes: array<vec4f>;  // (capacity,): layers, from the first block
@group(0) @binding(4) var<storage, read_write> parts: array<Part>;  // (capacity,)

@compute @workgroup_size(lanes)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let segment = segments[group.x];
    if (segment.points == 0u) {
        if (local == 0u) { parts[group.x].id = 0u; }
        return;
    }
    lists = vec2u(group.x + 1u, 0u);
    var places = vec2u();
    for (var k = local; k < segment.points; k += lanes) {
        let packed = points[segment.start + k];
        places += vec2u(packed & 0xffffu, packed >> 16u);
    }
    // Whole numbers up to 2^24 are exact.
    let all = total(Sums(0.0, vec3f(vec2f(places), 0.0), vec3f(), vec3f()), local).gradient.xy;
    workgroupBarrier();
    let middle = all / f32(segment.points);
    let given = planes[group.x].xyz;
    let start = vec3f(given.xy, given.z + dot(given.xy, middle));
    let found = fitted(start, middle, segment.points, newton_steps, false, local);
    let simplest = simplest_of(found, middle, segment.points, local);
    if (local == 0u) {
        parts[group.x] = Part(
            found.plane, found.value, simplest.xyz, simplest.w, middle, segment.points, group.x + 1u
        );
    }
}
