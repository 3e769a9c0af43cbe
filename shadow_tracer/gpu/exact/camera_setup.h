// needs: exact/depth_plane.h exact/camera_record.h
// What the camera's rays ask of a triangle: its record and its plane.
struct CameraSetUp {
    static inline void of(int triangle, const CameraRays& rays, const wp::array_t<wp::vec3d>& vertices,
                          const wp::array_t<wp::vec3i>& triangles, const wp::array_t<wp::vec4>& records,
                          const wp::array_t<wp::float64>& planes) {
        const wp::vec3i& corners = triangles.data[triangle];
        CameraRecord::pack(CameraRecord::at(records, triangle));
        DepthPlane::make(vertices.data[corners[0]], vertices.data[corners[1]], vertices.data[corners[2]], rays,
                         planes.data + PLANE_COLUMNS * (size_t)triangle);
    }
};
