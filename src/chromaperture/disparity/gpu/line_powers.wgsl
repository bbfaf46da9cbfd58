// Mean light and noise of the lines that share both sides, and the powers of a line's textures in whole steps; see
// `EdgeLikelihood.groups`. Every invocation looks through all lines.

@group(0) @binding(0) var<storage, read> facts: array<Line>;
@group(0) @binding(1) var<storage, read> numbers: array<u32>;  // of lines
@group(0) @binding(2) var<storage, read> textures: array<vec4f>;  // (textures, 4): energy of an end first
@group(0) @binding(3) var<storage, read> shared_by_all: array<f32>;  // colours (3, 3), noise
@group(0) @binding(4) var<storage, read_write> kinds: array<Line>;  // light and noise of its sides; steps of its powers

fn steps(energy: f32, noise: f32, texture: u32) -> f32 {
    let colours = vec3f(shared_by_all[0], shared_by_all[4], shared_by_all[8]);
    let power = max(energy - noise, least_texture * noise + 1.2e-38) / dot(colours, textures[4u * texture].xyz);
    return round(log2(power) / octaves);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let number = numbers[0];
    if (i >= number) { return; }
    let key = facts[i].key;
    var sums = vec4f();
    var count = 0.0;
    for (var k = 0u; k < number; k++) {
        if (facts[k].key == key) {
            sums += vec4f(facts[k].noise, facts[k].light);
            count += 1.0;
        }
    }
    let mean = sums / count;
    let sides = sides_of(select(key, 0u, key == unheard));
    let ends = select(facts[i].ends, facts[i].ends.yx, sides.z == 0u);  // near and far
    let of_noise = noise_of_end * dot(mean.xyz, vec3f(1.0));
    let powers = vec2f(steps(ends.x, of_noise, sides.x), steps(ends.y, of_noise, sides.y));
    kinds[i] = Line(mean.xyz, mean.w, powers, key);
}
