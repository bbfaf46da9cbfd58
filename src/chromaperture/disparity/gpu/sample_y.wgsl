// Views read between their rows, at every sub-pixel phase that the layers use; rows beyond the picture are its border.

@group(0) @binding(0) var<storage, read> planes: array<f32>;  // (planes, h, w), the views first
@group(0) @binding(1) var<storage, read> phases: array<vec4f>;  // (Ey, 2): four taps; the view
@group(0) @binding(2) var<storage, read_write> samples: array<f32>;  // (h + 2 pad_y, w, Ey)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= (height + 2u * pad_y) * width * phase_count) { return; }
    let e = i % phase_count;
    let x = (i / phase_count) % width;
    let y = i32(i / (phase_count * width)) - i32(pad_y);
    let taps = phases[2u * e];
    let column = u32(phases[2u * e + 1u].x) * width * height + x;
    samples[i] = taps.x * planes[column + inside(y - 1i, height) * width] + taps.y * planes[column + inside(y, height) * width]
        + taps.z * planes[column + inside(y + 1i, height) * width] + taps.w * planes[column + inside(y + 2i, height) * width];
}
