// What blocks tell of a pixel: the mean distance at which fits of planes put it from the answer, as a logarithm, and the
// spread of its block; see `learned_error_bar.of_fits` and `evidence_signs.py`.

@group(0) @binding(0) var<storage, read> surface: array<vec4f>;  // (h, w): layer first
@group(0) @binding(1) var<storage, read> fits: array<f32>;  // (skipped + fits, blocks): layers
@group(0) @binding(2) var<storage, read> spreads: array<f32>;  // (blocks,)
@group(0) @binding(3) var<storage, read_write> signs: array<vec2f>;  // (h, w)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let blocks = (height / block) * (width / block);
    let at = block_at(i / width, i % width);
    var sum = 0.0;
    for (var k = skipped; k < skipped + fit_count; k++) { sum += abs(fits[k * blocks + at] - surface[i].x); }
    signs[i] = vec2f(log(sum / f32(max(fit_count, 1u)) + least), spreads[at]);
}
