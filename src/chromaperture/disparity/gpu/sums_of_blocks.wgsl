// Of every plane by the mean evidence of its blocks: how much it falls when the answer is shifted, and the logarithm of
// what it is at the answer; see `evidence_signs.py`.

@group(0) @binding(0) var<storage, read> choice: array<u32>;  // (h, w)
@group(0) @binding(1) var<storage, read> profile: array<f32>;  // (blocks, shifts), nats a pixel
@group(0) @binding(2) var<storage, read> plane_count: array<u32>;
@group(0) @binding(3) var<storage, read_write> of_planes: array<vec2f>;  // (planes,)

var<workgroup> sums: array<vec3f, 64>;  // fall, evidence, number of blocks

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    if (group.x >= plane_count[0]) { return; }
    let across = width / block;
    var sum = vec3f();
    for (var i = local; i < across * (height / block); i += 64u) {
        if (choice[(i / across * block + block / 2u) * width + i % across * block + block / 2u] == group.x) {
            let here = profile[i * shift_count + middle];
            let sides = (profile[i * shift_count + before] + profile[i * shift_count + behind]) / 2.0;
            sum += vec3f(here - sides, here, 1.0);
        }
    }
    sums[local] = sum;
    workgroupBarrier();
    for (var half = 32u; half > 0u; half /= 2u) {
        if (local < half) { sums[local] += sums[local + half]; }
        workgroupBarrier();
    }
    if (local == 0u) {
        let mean = max(sums[0].xy / max(sums[0].z, 1.0), vec2f());
        of_planes[group.x] = vec2f(mean.x, log(mean.y + least_evidence));
    }
}
