in vec3 in_place;      // from -1 to 1 across the picture, and depth in metres
in vec4 in_streak;     // place across and along it, half of the length of its path, opacity in its middle
uniform vec2 to_depth; // of a projection
out vec4 streak;

void main() {
    streak = in_streak;
    gl_Position = vec4(in_place.xy, to_depth.x + to_depth.y / in_place.z, 1.0);
}
