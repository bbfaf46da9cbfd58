// Views read between their rows, at every sub-pixel phase that the layers use; rows beyond the picture are its border.
// One invocation takes `each` neighbours along y, whose taps overlap. Where `whole`, light counts in whole units. `margin`
// columns beside the picture are its border, too.

@group(0) @binding(0) var<storage, read> planes: array<f32>;  // (planes, h, w), the views first
@group(0) @binding(1) var<storage, read> phases: array<vec4f>;  // (Ey, 2): four taps; the view
@group(0) @binding(2) var<storage, read> stats: array<f32>;
@group(0) @binding(3) var<storage, read_write> samples: array<f32>;  // (h + 2 pad_y, w + 2 margin, Ey)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let tall = height + 2u * pad_y;
    let pitch = (width + 2u * margin) * phase_count;
    if (i >= ((tall + each - 1u) / each) * pitch) { return; }
    let e = i % phase_count;
    let first = each * (i / pitch);
    let taps = phases[2u * e];
    let x = inside(i32((i % pitch) / phase_count) - i32(margin), width);
    let column = u32(phases[2u * e + 1u].x) * width * height + x;
    let scale = select(1.0, stats[UNIT + 1u], whole);
    var before = vec4f();
    for (var n = 0u; n < each + 3u; n++) {
        let y = i32(first + n) - i32(pad_y) - 1i;
        before = vec4f(before.yzw, scale * planes[column + inside(y, height) * width]);
        let sum = dot(taps, before);
        if (n >= 3u && first + n - 3u < tall) { samples[(first + n - 3u) * pitch + i % pitch] = select(sum, round(sum), whole); }
    }
}
