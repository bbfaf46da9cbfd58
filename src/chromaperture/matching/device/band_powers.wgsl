// Powers of P and Q in windows, from their averaged products.

@group(0) @binding(0) var<storage, read> products: array<f32>;  // (windows, 3)
@group(0) @binding(1) var<storage, read_write> powers: array<vec2f>;  // (windows,)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i < windows) { powers[i] = vec2f(products[3u * i + 1u], products[3u * i + 2u]); }
}
