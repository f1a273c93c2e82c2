// One triangle that covers the picture, as far away as possible.
uniform mat3 rot_ned_view;
uniform vec2 tangent; // of half the field of view
uniform vec3 water_at; // still surface below the camera, relative to it
uniform vec2 ripples_at; // position of the camera in the drifting pattern of ripples
out vec2 place;       // 0 to 1
out vec3 ray;         // from the camera to a depth of 1
flat out vec3 sea;    // ripples_at, then the height of the camera above the still surface
flat out vec3 shaded; // light without the sun, of the light of the sea
flat out vec4 flat_rows[8];

void main() {
    place = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0;
    ray = rot_ned_view * vec3((place * 2.0 - 1.0) * tangent, 1.0);
    sea = vec3(ripples_at, water_at.z);
    shaded = sky_light.rgb / (sky_light.rgb + sun_light.rgb * max(-sun.z, 0.0));
    flat_rows = light_rows;
    gl_Position = vec4(place * 2.0 - 1.0, 1.0, 1.0);
}
