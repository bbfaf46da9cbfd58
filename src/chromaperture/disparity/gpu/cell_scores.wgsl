// Correlation of the views in a cell's window, of every layer: of two views, or 1 - sqrt(det) of the correlation matrix
// of three.

@group(0) @binding(0) var<storage, read> samples: array<f32>;  // (h + 2 pad_y, w + 2 pad_x, E)
@group(0) @binding(1) var<storage, read> places: array<vec4i>;  // (K, C): entry, whole px along x, along y, 0
@group(0) @binding(2) var<storage, read> stats: array<f32>;
@group(0) @binding(3) var<storage, read_write> score: array<f32>;  // (cells_tall, cells_wide, D)

const side = 2u * reach + 1u;
const wide = width + 2u * pad_x;

// Where a view's samples of a layer's window begin.
fn start_of(view: u32, layer: u32, x: u32, y: u32) -> u32 {
    let place = places[view * layer_count + layer];
    let column = u32(i32(x + pad_x - reach) + place.y);
    let row = u32(i32(y + pad_y - reach) + place.z);
    return (row * wide + column) * entry_count + u32(place.x);
}

fn samples_at(at: vec3u) -> vec3f {
    if (view_count == 2u) { return vec3f(samples[at.x], samples[at.y], 0.0); }
    return vec3f(samples[at.x], samples[at.y], samples[at.z]);
}

fn gain_of(square: f32, mean: f32, view: u32) -> f32 {
    return inverseSqrt(max(square - mean * mean, 0.0) + relative_epsilon * stats[VARIANCE + view] + 1.0e-30);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= cells_wide * cells_tall * layer_count) { return; }
    let layer = i % layer_count;
    let cell = i / layer_count;
    let x = 2u * (cell % cells_wide);
    let y = 2u * (cell / cells_wide);
    let starts = vec3u(
        start_of(0u, layer, x, y), start_of(1u, layer, x, y), start_of(view_count - 1u, layer, x, y)
    );
    let middle = samples_at(starts + (reach * wide + reach) * entry_count);  // taken off for the sake of 32 bits
    var sums = vec3f();
    var squares = vec3f();
    var products = vec3f();  // of the pairs 01, 02, 12
    for (var row = 0u; row < side; row++) {
        for (var column = 0u; column < side; column++) {
            let weight = f32(min(row + 1u, side - row) * min(column + 1u, side - column)) / 81.0;
            let here = samples_at(starts + (row * wide + column) * entry_count) - middle;
            sums += weight * here;
            squares += weight * here * here;
            products += weight * here.xxy * here.yzz;
        }
    }
    var gains = vec3f();
    for (var k = 0u; k < view_count; k++) { gains[k] = gain_of(squares[k], sums[k], k); }
    let rho = clamp((products - sums.xxy * sums.yzz) * gains.xxy * gains.yzz, vec3f(-1.0), vec3f(1.0));
    var found = rho.x;
    if (view_count == 3u) {
        let determinant = 1.0 + 2.0 * rho.x * rho.y * rho.z - dot(rho, rho);
        found = 1.0 - sqrt(max(determinant, 0.0));
    }
    score[cell * all_layers + first_layer + layer] = found;
}
