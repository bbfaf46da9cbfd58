// Covariance of the channels' texture, of unit mean variance, by the products of shades; see `edge_likelihood.py`.

@group(0) @binding(0) var<storage, read> products: array<vec4f>;  // (parts, 2): rr, gg, bb; rg, rb, gb
@group(0) @binding(1) var<storage, read_write> shared_by_all: array<f32>;  // colours (3, 3) first

@compute @workgroup_size(1)
fn main() {
    var own = vec3f();
    var mixed = vec3f();
    for (var part = 0u; part < parts; part++) {
        own += products[2u * part].xyz;
        mixed += products[2u * part + 1u].xyz;
    }
    own += max(1.0e-3 * dot(own, vec3f(1.0)), 1.2e-38);  // an empty channel; an even picture
    let mean = dot(own, vec3f(1.0)) / 3.0;
    own /= mean;
    mixed *= (1.0 - own_colour) / mean;
    let rows = mat3x3f(
        vec3f(own.x, mixed.x, mixed.y), vec3f(mixed.x, own.y, mixed.z), vec3f(mixed.y, mixed.z, own.z)
    );
    for (var k = 0u; k < 9u; k++) { shared_by_all[k] = rows[k / 3u][k % 3u]; }
}
