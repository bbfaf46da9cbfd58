// Of every block the logarithm of the spread of its window's evidence about the answer; see `evidence_signs.py`.

@group(0) @binding(0) var<storage, read> pooled: array<f32>;  // (blocks, shifts), nats a pixel, averaged in windows
@group(0) @binding(1) var<storage, read> shifts: array<f32>;  // and what each stands for
@group(0) @binding(2) var<storage, read_write> signs: array<f32>;  // (blocks,)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= blocks) { return; }
    var evidence = array<f32, shift_count>();
    for (var s = 0u; s < shift_count; s++) { evidence[s] = pooled[i * shift_count + s] * samples; }
    signs[i] = log_spread(&evidence);
}
