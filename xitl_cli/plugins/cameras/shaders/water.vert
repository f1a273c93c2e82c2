// A fan of rings about the camera, displaced by the components of the sea.
uniform mat4 to_clip;
uniform vec3 water_at;        // still surface below the camera, relative to it
uniform sampler2D components; // (wave number north, east, phase at the camera, amplitude)
uniform int count;
uniform float water_id, water_temperature;
in vec2 in_bearing;           // unit vector
in vec2 in_ring;              // radius, distance to the next ring
out vec2 slope;
flat out float id;
out float temperature, depth_m;

void main() {
    vec2 ne = in_bearing * in_ring.x;
    float z = 0.0;
    slope = vec2(0.0);
    for (int n = 0; n < count; n++) {
        vec4 wave = texelFetch(components, ivec2(n, 0), 0);
        // Rings cannot show waves that are shorter than two of their distances.
        float shown = clamp(2.0 - 0.64 * length(wave.xy) * in_ring.y, 0.0, 1.0) * wave.w;
        float angle = dot(wave.xy, ne) + wave.z;
        z += shown * cos(angle);
        slope -= shown * sin(angle) * wave.xy;
    }
    id = water_id;
    temperature = water_temperature;
    gl_Position = to_clip * vec4(vec3(ne, 0.0) + water_at - vec3(0.0, 0.0, z), 1.0);
    depth_m = gl_Position.w;
}
