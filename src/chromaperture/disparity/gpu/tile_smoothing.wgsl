// Power of the spectra of tiles, averaged over neighbouring frequencies along one axis; spectra repeat beyond the ends.

@group(0) @binding(0) var<storage, read> spectra: array<vec2f>;  // (tiles, 3, size, size / 2 + 1); power in x later
@group(0) @binding(1) var<storage, read> taps: array<f32>;  // (2 reach + 1,)
@group(0) @binding(2) var<storage, read_write> power: array<vec2f>;

const columns = size / 2u + 1u;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= pictures * size * columns) { return; }
    let x = i % columns;
    let y = i / columns % size;
    let picture = i / (columns * size) * size * columns;
    var sum = 0.0;
    for (var k = 0u; k < 2u * reach + 1u; k++) {
        var row = y;
        var column = x;
        if (along_x) {
            column = (x + k + size - reach) % size;
            if (column >= columns) {  // the other half of a real picture's spectrum
                column = size - column;
                row = (size - y) % size;
            }
        } else {
            row = (y + k + size - reach) % size;
        }
        let here = spectra[picture + row * columns + column];
        sum += taps[k] * select(here.x, dot(here, here), is_spectrum);
    }
    power[i] = vec2f(sum, 0.0);
}
