// Correlation of the views in a cell's window, of every layer: of two views, or 1 - sqrt(det) of the correlation matrix
// of three.

@group(0) @binding(0) var<storage, read> samples: array<f32>;  // (h + 2 pad_y, w + 2 pad_x, E)
@group(0) @binding(1) var<storage, read> places: array<vec4i>;  // (K, C): entry, whole px along x, along y, 0
@group(0) @binding(2) var<storage, read> stats: array<f32>;
@group(0) @binding(3) var<storage, read_write> score: array<f32>;  // (cells_tall, cells_wide, D)

const REACH = 2i;  // px

// Where a view's samples of a pixel of a layer lie; beyond the samples the border goes on.
fn sample_at(view: u32, layer: u32, x: i32, y: i32) -> f32 {
    let place = places[view * layer_count + layer];
    let column = inside(x + place.y + i32(pad_x), width + 2u * pad_x);
    let row = inside(y + place.z + i32(pad_y), height + 2u * pad_y);
    return samples[(row * (width + 2u * pad_x) + column) * entry_count + u32(place.x)];
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
    let x = 2i * i32(cell % cells_wide);
    let y = 2i * i32(cell / cells_wide);
    var middle = vec3f();  // of the window, taken off for the sake of 32 bits
    for (var k = 0u; k < view_count; k++) { middle[k] = sample_at(k, layer, x, y); }
    var sums = vec3f();
    var squares = vec3f();
    var products = vec3f();  // of the pairs 01, 02, 12
    for (var row = -REACH; row <= REACH; row++) {
        for (var column = -REACH; column <= REACH; column++) {
            let weight = f32((REACH + 1i - abs(row)) * (REACH + 1i - abs(column))) / 81.0;
            var here = vec3f();
            for (var k = 0u; k < view_count; k++) { here[k] = sample_at(k, layer, x + column, y + row) - middle[k]; }
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
