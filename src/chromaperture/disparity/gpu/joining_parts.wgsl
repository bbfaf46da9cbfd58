// What the joining of planes keeps of parts and of pairs; see `plane_merging.py`. A part is a list of segments of the
// points: those of the planes that were joined to it, in the order in which the CPU puts them.

struct Segment {
    start: u32,
    points: u32,
    next: u32,  // 1 + segment, 0 behind the last
    last: u32,  // of a part's first segment: its last; in the end the plane that the segment's blocks lie on
}

struct Part {  // at the place of its first segment, its slot; planes count in layers, from the middle
    plane: vec3f,
    value: f32,  // log-likelihood of its points
    simplest: vec3f,
    numbers: f32,  // that the simplest plane takes: 1 or 3
    middle: vec2f,
    points: u32,
    id: u32,  // 1 + number among all parts that there ever were, 0 where the part is gone
}

struct Join {  // the first: how many are listed (slots), how many of these were tried (one), parts joined (other)
    plane: vec3f,  // from the middle of both
    value: f32,
    simplest: vec3f,
    numbers: f32,
    gain: f32,  // loss less what may be lost: below 0 where both may be joined
    slots: u32,  // of both parts, 16 bits each
    one: u32,  // ids of both parts: where one is another now the join is void
    other: u32,
}

fn moved(plane: vec3f, by: vec2f) -> vec3f {
    return vec3f(plane.xy, plane.z + dot(plane.xy, by));
}

fn joint_middle(a: Part, b: Part) -> vec2f {
    return (a.middle * f32(a.points) + b.middle * f32(b.points)) / f32(a.points + b.points);
}
