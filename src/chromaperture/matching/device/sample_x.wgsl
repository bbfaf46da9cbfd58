// The samples of `sample_y.wgsl` read between their columns: an entry is a view at one phase along x and one along y. One
// invocation takes `each` neighbours along x, whose taps overlap.

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
    let count = (wide + each - 1u) / each;  // invocations of a row
    if (i >= (height + 2u * pad_y) * count * entry_count) { return; }
    let e = i % entry_count;
    let first = each * ((i / entry_count) % count);
    let y = i / (entry_count * count);
    let taps = phases[2u * e];
    let row = y * width * phase_count + u32(phases[2u * e + 1u].x);
    var before = vec4f();
    for (var n = 0u; n < each + 3u; n++) {
        let x = i32(first + n) - i32(pad_x) - 1i;
        before = vec4f(before.yzw, rows[row + inside(x, width) * phase_count]);
        let sum = dot(taps, before);
        if (n >= 3u && first + n - 3u < wide) {
            samples[(y * wide + first + n - 3u) * entry_count + e] = select(sum, round(sum), whole);
        }
    }
}
