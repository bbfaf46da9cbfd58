// Power of the spectra of tiles, averaged over neighbouring frequencies along one axis; spectra repeat beyond the ends.
// An invocation has four neighbours along the axis, whose frequencies overlap.

@group(0) @binding(0) var<storage, read> before: array<f32>;  // (tiles, 3, size, size / 2 + 1), complex, or powers later
@group(0) @binding(1) var<storage, read> taps: array<f32>;  // (2 reach + 4,): three zeros at the end
@group(0) @binding(2) var<storage, read_write> power: array<f32>;

const columns = size / 2u + 1u;
const fours = (select(size, columns, along_x) + 3u) / 4u;

fn power_at(at: u32) -> f32 {
    if (!is_spectrum) { return before[at]; }
    let value = vec2f(before[2u * at], before[2u * at + 1u]);
    return dot(value, value);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= pictures * select(columns, size, along_x) * fours) { return; }
    let first = 4u * select(i / columns % fours, i % fours, along_x);
    let line = select(i % columns, i / fours % size, along_x);
    let picture = i / (fours * select(columns, size, along_x)) * size * columns;
    let mirrored_line = select(size - line, 0u, line == 0u);
    var sum = vec4f();
    var weights = vec4f();  // of the four frequencies, for what is read
    var place = (first + size - reach) % size;
    for (var k = 0u; k < 2u * reach + 4u; k++) {
        weights = vec4f(taps[k], weights.xyz);
        var at = picture + place * columns + line;
        if (along_x) {  // the other half of a real picture's spectrum is the first one, mirrored
            at = picture + select(line * columns + place, mirrored_line * columns + size - place, place >= columns);
        }
        sum += weights * power_at(at);
        place = select(place + 1u, 0u, place + 1u == size);
    }
    for (var n = 0u; n < min(4u, select(size, columns, along_x) - first); n++) {
        power[picture + select((first + n) * columns + line, line * columns + first + n, along_x)] = sum[n];
    }
}
