// Spectra of tapered windows, less their mean under the taper; see `spectral_model.py`, Windows. A workgroup has one
// window.

@group(0) @binding(0) var<storage, read> rows: array<vec2f>;  // (window rows, pairs, w, 3, 2): `window_rows.wgsl`
@group(0) @binding(1) var<storage, read> waves: array<vec2f>;  // (side, pairs, 2): cosine and sine
@group(0) @binding(2) var<storage, read> numbers: array<vec2i>;  // (frequencies,): waves a period along x and y
@group(0) @binding(3) var<storage, read> taper: array<vec2f>;  // (frequencies,): of an even picture
@group(0) @binding(4) var<storage, read_write> spectra: array<f32>;  // (windows, 3, 2, frequencies)

var<workgroup> mean: vec3f;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let window = group.x + group.y * groups.x;
    if (window >= window_rows * window_columns) { return; }
    let left = i32(window % window_columns * stride) - i32(side / 2u);
    let first = window / window_columns * pairs;
    if (local < 3u) {
        var sum = 0.0;
        for (var s = 0u; s < side; s++) {
            sum += rows[((first * width + repeated(left + i32(s), width)) * 3u + local) * 2u].x * waves[s * pairs * 2u].x;
        }
        mean[local] = sum;
    }
    workgroupBarrier();
    let means = mean;
    for (var f = local; f < frequencies; f += 64u) {
        let number = numbers[f];
        let down = u32(abs(number.y));
        let line = (first + down / 2u) * width;
        let mirror = select(1.0, -1.0, number.y < 0i);
        var real = vec3f();
        var imaginary = vec3f();
        for (var s = 0u; s < side; s++) {
            let at = (line + repeated(left + i32(s), width)) * 6u + down % 2u;
            let along = waves[s * pairs * 2u + u32(number.x)];
            let red = rows[at];
            let green = rows[at + 2u];
            let blue = rows[at + 4u];
            let even = vec3f(red.x, green.x, blue.x);
            let odd = mirror * vec3f(red.y, green.y, blue.y);
            real += even * along.x - odd * along.y;
            imaginary -= odd * along.x + even * along.y;
        }
        real -= means * taper[f].x;
        imaginary -= means * taper[f].y;
        for (var k = 0u; k < 3u; k++) {
            let to = (window * 6u + 2u * k) * frequencies + f;
            spectra[to] = real[k];
            spectra[to + frequencies] = imaginary[k];
        }
    }
}
