// The samples of `sample_y.wgsl` read between their columns: an entry is a view at one phase along x and one along y.

@group(0) @binding(0) var<storage, read> rows: array<f32>;  // (h + 2 pad_y, w, Ey)
@group(0) @binding(1) var<storage, read> phases: array<vec4f>;  // (E, 2): four taps; the phase along y
@group(0) @binding(2) var<storage, read_write> samples: array<f32>;  // (h + 2 pad_y, w + 2 pad_x, E)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let wide = width + 2u * pad_x;
    if (i >= (height + 2u * pad_y) * wide * entry_count) { return; }
    let e = i % entry_count;
    let x = i32((i / entry_count) % wide) - i32(pad_x);
    let taps = phases[2u * e];
    let row = (i / (entry_count * wide)) * width * phase_count + u32(phases[2u * e + 1u].x);
    samples[i] = taps.x * rows[row + inside(x - 1i, width) * phase_count] + taps.y * rows[row + inside(x, width) * phase_count]
        + taps.z * rows[row + inside(x + 1i, width) * phase_count] + taps.w * rows[row + inside(x + 2i, width) * phase_count];
}
