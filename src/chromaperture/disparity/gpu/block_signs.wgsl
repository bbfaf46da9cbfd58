// Of every block the logarithm of the spread of its window's evidence about the answer; see `evidence_signs.py`.

@group(0) @binding(0) var<storage, read> pooled: array<f32>;  // (blocks, shifts), nats a pixel, averaged in windows
@group(0) @binding(1) var<storage, read> shifts: array<f32>;  // and what each stands for
@group(0) @binding(2) var<storage, read_write> spreads: array<f32>;  // (blocks,)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= blocks) { return; }
    var most = -1.0e30;
    for (var s = 0u; s < shift_count; s++) { most = max(most, pooled[i * shift_count + s]); }
    var total = 0.0;
    var squares = 0.0;
    for (var s = 0u; s < shift_count; s++) {
        let likely = exp((pooled[i * shift_count + s] - most) * samples) * shifts[shift_count + s];
        total += likely;
        squares += likely * shifts[s] * shifts[s];
    }
    spreads[i] = log(sqrt(squares / total) + least_spread);
}
