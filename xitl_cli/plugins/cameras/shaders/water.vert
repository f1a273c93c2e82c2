// A fan of rings about the camera, displaced by the components of the sea. Slowly varying terms of the light are
// computed here, since the fan is fine and a picture has many more pixels than the fan has corners.
uniform mat4 to_clip;
uniform vec3 water_at;        // still surface below the camera, relative to it
uniform vec2 origin_ne;       // position of the camera modulo the tile of the ripples
uniform sampler2D components; // (wave number north, east, phase at the camera, amplitude)
uniform int count;
uniform vec3 foam_frame;      // corner relative to the camera, and size of the map of foam
uniform float water_id, water_temperature;
in vec2 in_bearing;           // unit vector
in vec2 in_ring;              // radius, distance to the next ring
out vec3 view;                // unit vector from the camera
out vec2 slope, on_map, on_foam;
out vec4 far;                 // share of the light that passes the air, share of the ripples that a pixel shows,
                              // roughness, the steepest reflection
out vec3 glitter;             // radiance of the sun if all facets were right
out vec2 facet;               // slope of a facet that reflects the sun
out float rise;
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
    rise = z;
    vec3 position = vec3(ne, 0.0) + water_at - vec3(0.0, 0.0, z);
    float distance_m = length(position);
    view = position / distance_m;
    on_map = ne + origin_ne;
    on_foam = (ne - foam_frame.xy) / foam_frame.z;
    // What the pattern of ripples no longer shows, far away, makes the reflection rough.
    float resolved = clamp(18.0 / distance_m, 0.0, 1.0);
    float rough = 0.0008 + water.w * (1.0 - 0.9 * resolved);
    far = vec4(exp(-sky_light.w * distance_m), resolved, rough, -0.02 - 0.6 * sqrt(rough));
    // Cox and Munk 1954: the radiance of the sun's glitter from the chance of a slope, without its exponential
    vec3 half_way = normalize(sun.xyz - view);
    float cosine = min(half_way.z, -0.05), cosine2 = cosine * cosine;
    facet = half_way.xy / -cosine;
    float away = 1.0 - max(dot(half_way, -view), 0.0), away2 = away * away;
    float mirror = 0.02 + 0.98 * away2 * away2 * away;
    float facing = max(view.z, 0.02);
    glitter = sun_light.rgb * mirror * step(half_way.z, 0.0) / (4.0 * facing * rough * cosine2 * cosine2);
    id = water_id;
    temperature = water_temperature;
    gl_Position = to_clip * vec4(position, 1.0);
    depth_m = gl_Position.w;
}
