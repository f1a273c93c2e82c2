uniform mat4 to_clip;       // of positions relative to the camera
uniform mat3 rot_ned_model;
uniform vec3 model_at;      // relative to the camera
uniform float first_id;      // number of the first object of the model
uniform vec4 keep;          // positions with a positive product are drawn
in vec3 in_position;
in vec3 in_normal;
in vec4 in_colour;          // w: roughness of the pattern
in float in_id;
in float in_temperature;
out vec3 position, normal, in_model, normal_in_model;
out vec4 colour;
flat out float id;
out float temperature, depth_m;

void main() {
    in_model = in_position;
    normal_in_model = in_normal;
    position = rot_ned_model * in_position + model_at;
    normal = rot_ned_model * in_normal;
    colour = in_colour;
    id = in_id + first_id;
    temperature = in_temperature;
    gl_Position = to_clip * vec4(position, 1.0);
    depth_m = gl_Position.w;
    gl_ClipDistance[0] = dot(keep, vec4(position, 1.0));
}
