// Lines that share their covariances, in parts of at most `most_lines`: the first of each writes it.

@group(0) @binding(0) var<storage, read> kinds: array<Line>;  // light and noise of its sides; steps of its powers
@group(0) @binding(1) var<storage, read> textures: array<vec4f>;  // (textures, 4): see `line_textures.py`
@group(0) @binding(2) var<storage, read> shared_by_all: array<f32>;  // colours (3, 3), noise (samples, samples)
@group(0) @binding(3) var<storage, read_write> numbers: array<atomic<u32>>;  // of lines, of parts
@group(0) @binding(4) var<storage, read_write> parts: array<Part>;

fn alike(a: Line, b: Line) -> bool {
    return a.key == b.key && all(a.ends == b.ends);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let number = atomicLoad(&numbers[0]);
    if (i >= number) { return; }
    let own = kinds[i];
    if (own.key == unheard) { return; }
    var rank = 0u;
    for (var k = 0u; k < i; k++) { rank += select(0u, 1u, alike(own, kinds[k])); }
    if (rank % most_lines != 0u) { return; }
    let at = atomicAdd(&numbers[1], 1u);
    let sides = sides_of(own.key);
    let colours = vec3f(shared_by_all[0], shared_by_all[4], shared_by_all[8]);
    let level = dot(colours, vec3f(1.0)) / 3.0;
    let powers = vec3f(exp2(octaves * own.ends), unknown_level * unknown_level * own.light * own.light / level);
    // What `stages.edge_costs` adds to the variances: a share of the trace.
    let first_share = textures[4u * sides.x + 2u].xyz;  // sums of squares of the share of the first side, and of its rest
    let second_share = textures[4u * sides.x + 3u].xyz;
    let near_share = select(first_share, second_share, sides.z == 1u);
    let far_share = select(second_share, first_share, sides.z == 1u);
    let near = colours * (powers.x * textures[4u * sides.x + 1u].xyz + powers.z);
    let far = colours * (powers.y * textures[4u * sides.y + 1u].xyz + powers.z);
    let variance_of_noise = shared_by_all[9];
    let trace = f32(samples) * variance_of_noise * dot(own.noise, vec3f(1.0)) + dot(near, near_share) + dot(far, far_share);
    parts[at].sides = sides;
    parts[at].values = vec4f(powers, least_of_trace / f32(3u * samples) * trace);
    parts[at].noise = own.noise;
    var count = 0u;
    for (var k = i; k < number; k++) {
        if (count < most_lines && alike(own, kinds[k])) {
            parts[at].members[count] = k;
            count++;
        }
    }
    parts[at].count = count;
}
