// Sums of a volume over squares of pixels; what is left over at the right and below is left out.

@group(0) @binding(0) var<storage, read> likelihood: array<f32>;  // (h, w, count)
@group(0) @binding(1) var<storage, read_write> blocks: array<f32>;  // (h / size, w / size, count)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let across = width / size;
    if (i >= across * (height / size) * count) { return; }
    let block = i / count;
    let first = (block / across * size * width + block % across * size) * count + i % count;
    var sum = 0.0;
    for (var y = 0u; y < size; y++) {
        for (var x = 0u; x < size; x++) { sum += likelihood[first + (y * width + x) * count]; }
    }
    blocks[i] = sum;
}
