// Where the planes of a pixel and of the one before it, to the left or above, differ by more than `apart` layers.

@group(0) @binding(0) var<storage, read> there: array<f32>;  // (h, w): layer of the plane
@group(0) @binding(1) var<storage, read_write> steps: array<u32>;  // (h, w): 1 where they do

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let across = i % width > 0u && abs(there[i] - there[max(i, 1u) - 1u]) > apart;
    let down = i >= width && abs(there[i] - there[max(i, width) - width]) > apart;
    steps[i] = select(0u, 1u, across || down);
}
