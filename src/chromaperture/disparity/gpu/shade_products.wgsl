// Products of the channels' shades, what the finer of two Gaussians has more than the coarser, summed over
// pixels; see `edge_likelihood.py`. So many parts as there are workgroups; the CPU adds these.

@group(0) @binding(0) var<storage, read> fine: array<f32>;  // (h, w, 3)
@group(0) @binding(1) var<storage, read> coarse: array<f32>;  // (h, w, 3)
@group(0) @binding(2) var<storage, read_write> products: array<vec4f>;  // (parts, 2): rr, gg, bb; rg, rb, gb

var<workgroup> own: array<vec3f, 64>;
var<workgroup> mixed: array<vec3f, 64>;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    var squares = vec3f();
    var others = vec3f();
    for (var i = group.x * 64u + local; i < height * width; i += 64u * parts) {
        let at = 3u * i;
        let shade = vec3f(fine[at] - coarse[at], fine[at + 1u] - coarse[at + 1u], fine[at + 2u] - coarse[at + 2u]);
        squares += shade * shade;
        others += vec3f(shade.x * shade.y, shade.x * shade.z, shade.y * shade.z);
    }
    own[local] = squares;
    mixed[local] = others;
    workgroupBarrier();
    for (var half = 32u; half > 0u; half /= 2u) {
        if (local < half) {
            own[local] += own[local + half];
            mixed[local] += mixed[local + half];
        }
        workgroupBarrier();
    }
    if (local == 0u) {
        products[2u * group.x] = vec4f(own[0], 0.0);
        products[2u * group.x + 1u] = vec4f(mixed[0], 0.0);
    }
}
