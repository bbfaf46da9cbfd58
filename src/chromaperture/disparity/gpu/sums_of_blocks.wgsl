// Of every plane by all evidence of its blocks: how much it falls when the answer is shifted, and the logarithms of the
// spread of the shift and of what it is at the answer; see `evidence_signs.py`.

@group(0) @binding(0) var<storage, read> choice: array<u32>;  // (h, w)
@group(0) @binding(1) var<storage, read> profile: array<f32>;  // (blocks, shifts), nats a pixel
@group(0) @binding(2) var<storage, read> shifts: array<f32>;  // and what each stands for
@group(0) @binding(3) var<storage, read> plane_count: array<u32>;
@group(0) @binding(4) var<storage, read_write> of_planes: array<vec4f>;  // (planes,)

var<workgroup> sums: array<array<f32, shift_count + 1u>, 64>;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let across = width / block;
    if (group.x >= plane_count[0]) { return; }
    var sum = array<f32, shift_count + 1u>();  // last the number of blocks
    for (var i = local; i < across * (height / block); i += 64u) {
        if (choice[(i / across * block + block / 2u) * width + i % across * block + block / 2u] == group.x) {
            for (var s = 0u; s < shift_count; s++) { sum[s] += profile[i * shift_count + s]; }
            sum[shift_count] += 1.0;
        }
    }
    sums[local] = sum;
    workgroupBarrier();
    for (var half = 32u; half > 0u; half /= 2u) {
        if (local < half) {
            for (var s = 0u; s <= shift_count; s++) { sums[local][s] += sums[local + half][s]; }
        }
        workgroupBarrier();
    }
    if (local > 0u) { return; }
    let count = max(sums[0][shift_count], 1.0);
    var evidence = array<f32, shift_count>();
    for (var s = 0u; s < shift_count; s++) { evidence[s] = sums[0][s] * samples; }
    let fall = (sums[0][middle] - (sums[0][before] + sums[0][behind]) / 2.0) / count;
    of_planes[group.x] = vec4f(
        max(fall, 0.0), log_spread(&evidence), log(max(sums[0][middle] / count, 0.0) + least_evidence), 0.0
    );
}
