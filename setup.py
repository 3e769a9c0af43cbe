# SPDX-License-Identifier: Apache-2.0
"""The metadata and the files of the package.

They stand here and not in pyproject.toml, because `colcon build --symlink-install` runs this file without that one.
"""

from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

NAME = "shadow_tracer"

setup(
    name=NAME,
    version="0.1.0",
    description=(
        "Which pixels of a depth image does a light reach? Exact shadows of moving triangle meshes at camera rate, "
        "as a library and a ROS 2 node"
    ),
    long_description=(Path(__file__).resolve().parent / "README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    author="The shadow_tracer authors",
    keywords=["shadow", "ray tracing", "depth camera", "robotics", "ros2", "warp"],
    classifiers=[
        "Development Status :: 4 - Beta",
        "Intended Audience :: Developers",
        "Intended Audience :: Science/Research",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3",
        "Programming Language :: Python :: 3.10",
        "Programming Language :: Python :: 3.11",
        "Programming Language :: Python :: 3.12",
        "Topic :: Scientific/Engineering",
        "Typing :: Typed",
    ],
    python_requires=">=3.10",
    install_requires=["numpy>=1.26", "warp-lang>=1.19"],
    extras_require={
        # ROS 2 Jazzy from wheels (x86_64, glibc 2.28 or newer). Beside an installed ROS 2 leave this extra out.
        "ros": ["ros-jazzy-rclpy[fastrtps]>=7.1.6,<7.2", "ros-jazzy-common-interfaces>=5.3.6,<5.4"],
        # mesh.files of the node: concave polygons, and formats that have no reader here.
        "mesh": ["mapbox-earcut>=1.0.3", "trimesh>=4.4"],
        # Pictures and coloured meshes of doses; plans by a solver.
        "dose": ["matplotlib>=3.8", "scipy>=1.11", "trimesh>=4.4"],
        # Intensities from IES LM-63 files.
        "photometry": ["photompy>=0.3"],
        # Lights of type sun.
        "sun": ["ephem>=4.1.5"],
        # `shadow_tracer bag` on recordings, without ROS.
        # Pillow is for compressedDepth alone, lz4 and mcap for recordings that were cut off.
        "bag": [
            "lz4>=4.3",
            "mcap>=1.2",
            "pillow>=10.3",
            "pyyaml>=6.0",
            "rich>=13.7",
            "rosbags>=0.11",
            "scipy>=1.11",
            "zstandard>=0.22",
        ],
        # `shadow_tracer bags --engine dask`, on a cluster of Dask.
        "fleet": ["distributed>=2024.1"],
        # `shadow_tracer terrain`; sunlight() of the library takes ephem and xarray of it.
        "terrain": [
            "ephem>=4.1.5",
            "h5netcdf>=1.3",
            "h5py>=3.10",
            "matplotlib>=3.8",
            "pillow>=10.3",
            "rasterio>=1.3.9",
            "rich>=13.7",
            "tzdata>=2024.1",
            "xarray>=2024.1",
            "zarr>=3.0; python_version >= '3.11'",
        ],
        # Depth images of the transport compressedDepth that are PNG; RVL needs nothing.
        "compressed": ["pillow>=10.3"],
        "demo": ["pillow>=10.3", "rich>=13.7"],
        "benchmark": ["embreex>=2.17.7", "matplotlib>=3.8", "pillow>=10.3", "rich>=13.7", "trimesh>=4.4"],
        # DracoPy is optional to mesh.files: only Draco-compressed glTF needs it.
        "test": [
            "DracoPy>=1.5",
            "pillow>=10.3",
            "pytest>=8.2",
            "pytest-randomly>=3.16",
            "pytest-xdist>=3.6",
            "pyyaml>=6.0",
            "setuptools>=64",
        ],
        # Upper bounds: a new release of these may find new faults in old code.
        "dev": [
            "build>=1.2",
            "clang-format>=20,<21",
            "clang-tidy>=20,<21",
            "mypy>=2.4,<2.5",
            "pre-commit>=4.0",
            "ruff>=0.17,<0.18",
        ],
    },
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "gpu/**/*.h"]},
    include_package_data=False,
    zip_safe=False,
    entry_points={
        "console_scripts": [
            f"shadow_lifecycle_node = {NAME}.ros.node.process:lifecycle_main",
            f"shadow_node = {NAME}.ros.node.process:main",
            f"shadow_tracer = {NAME}.apps.cli:main",
        ]
    },
    # These make it a ROS 2 package: the marker that the ament index looks for, and what ROS tools read.
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", sorted(glob("config/*.yaml") + glob("config/*.xml") + glob("config/*.rviz"))),
        (f"share/{NAME}/launch", sorted(glob("launch/*.launch.*"))),
        # `ros2 run` looks in lib/<package>, pip puts console scripts in bin: each launcher finds the script from there.
        (f"lib/{NAME}", sorted(glob("scripts/shadow_*"))),
    ],
)
