// The fraction of the tiles' power that is no noise, at every frequency; see `readable/tiles.py`.

@group(0) @binding(0) var<storage, read> power: array<f32>;  // (tiles, 3, size, size / 2 + 1)
@group(0) @binding(1) var<storage, read> noise: array<f32>;  // (tiles, 3): power of the noise at any frequency
@group(0) @binding(2) var<storage, read_write> signal_share: array<f32>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= pictures * frequencies) { return; }
    let least = noise[i / frequencies];
    signal_share[i] = clamp(1.0 - least / max(power[i], least + 1.0e-30), 0.0, 1.0);  // 1e-30: no division by 0
}
