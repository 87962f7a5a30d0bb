"""Extracts isosurfaces with VTK's flying edges: with Embree the peer that the experiment `iso` measures ours against.

    flying_edges.py VOLUME TYPE X Y Z

VOLUME is a file of X times Y times Z samples and nothing else, x fastest, little-endian; TYPE is u8, u16 or f32. The
program says VTK's version in a line, and then obeys the lines it is sent, answering each with a line of JSON:

    extract ISOVALUE FILE   extracts that isosurface, and writes it to FILE as `embree.cpp` reads it

Time is that of the extraction alone, by the whole process. Samples lie at whole coordinates. Without VTK it ends with
status 3.
"""
import json
import struct
import sys
import time

NO_VTK = 3

try:
    from vtkmodules.vtkCommonCore import vtkSMPTools, vtkVersion
    from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D
    from vtkmodules.vtkIOImage import vtkImageReader2
except ImportError as error:
    print(f"flying_edges: {error}", file=sys.stderr)
    sys.exit(NO_VTK)


def read(path, kind, dims):
    reader = vtkImageReader2()
    reader.SetFileName(path)
    reader.SetFileDimensionality(3)
    reader.SetDataExtent(*(place for count in dims for place in (0, count - 1)))
    {
        "u8": reader.SetDataScalarTypeToUnsignedChar,
        "u16": reader.SetDataScalarTypeToUnsignedShort,
        "f32": reader.SetDataScalarTypeToFloat,
    }[kind]()
    reader.SetDataByteOrderToLittleEndian()
    reader.SetNumberOfScalarComponents(1)
    reader.SetHeaderSize(0)
    reader.FileLowerLeftOn()
    reader.Update()
    return reader.GetOutput()


def write(mesh, path):
    """Writes vertices and triangles; returns how many there are of each."""
    points = mesh.GetPoints().GetData()
    polygons = mesh.GetPolys()
    polygons.ConvertTo32BitStorage()
    counts = points.GetNumberOfTuples(), polygons.GetNumberOfCells()
    with open(path, "wb") as file:
        file.write(struct.pack("<III", *counts, 0))
        file.write(memoryview(points))
        file.write(memoryview(polygons.GetConnectivityArray()))
    return counts


def extract(edges, isovalue, path):
    edges.SetValue(0, isovalue)
    cpu, wall = time.process_time(), time.perf_counter()
    edges.Update()
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    vertices, triangles = write(edges.GetOutput(), path)
    return {"cpu_ms": 1e3 * cpu, "wall_ms": 1e3 * wall, "vertices": vertices, "triangles": triangles}


def main():
    path, kind, *dims = sys.argv[1:]
    vtkSMPTools.SetBackend("Sequential")
    edges = vtkFlyingEdges3D()
    edges.SetInputData(read(path, kind, [int(count) for count in dims]))
    edges.ComputeNormalsOff()
    edges.ComputeGradientsOff()
    edges.ComputeScalarsOff()
    print(json.dumps({"version": vtkVersion.GetVTKVersion()}), flush=True)
    for line in sys.stdin:
        command, isovalue, mesh = line.split(maxsplit=2)
        if command != "extract":
            sys.exit(f"flying_edges: there is no command {command}")
        print(json.dumps(extract(edges, float(isovalue), mesh.strip())), flush=True)


main()
