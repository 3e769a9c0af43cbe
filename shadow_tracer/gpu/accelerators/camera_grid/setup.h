// needs: accelerators/camera_grid/depth_plane.h accelerators/camera_grid/record.h
// What the camera's rays ask of a triangle: its record and its plane.
struct SetUp {
    static inline void of(int triangle, const Grid& grid, const wp::array_t<wp::vec3d>& vertices,
                          const wp::array_t<wp::vec3i>& triangles, const wp::array_t<wp::vec4>& records,
                          const wp::array_t<wp::float64>& planes) {
        const wp::vec3i& corners = triangles.data[triangle];
        CameraRecord::pack(CameraRecord::at(records, triangle));
        DepthPlane::make(vertices.data[corners[0]], vertices.data[corners[1]], vertices.data[corners[2]], grid,
                         planes.data + PLANE_COLUMNS * (size_t)triangle);
    }
};
