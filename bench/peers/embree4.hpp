// The few declarations of Embree 4 that we call, for machines that have its library and not its headers.
//
// Names, values and layouts are those of Embree's manual pages for 4.2 and later, where a hit holds one member more.
#pragma once

#include <cstddef>
#include <cstring>
#include <sys/types.h>

using RTCDevice = struct RTCDeviceOpaque*;
using RTCScene = struct RTCSceneOpaque*;
using RTCGeometry = struct RTCGeometryOpaque*;

static const unsigned RTC_INVALID_GEOMETRY_ID = ~0u;

enum RTCSceneFlags { RTC_SCENE_FLAG_NONE = 0, RTC_SCENE_FLAG_DYNAMIC = 1, RTC_SCENE_FLAG_ROBUST = 4 };
enum RTCBuildQuality { RTC_BUILD_QUALITY_LOW = 0, RTC_BUILD_QUALITY_MEDIUM = 1, RTC_BUILD_QUALITY_HIGH = 2 };
enum RTCGeometryType { RTC_GEOMETRY_TYPE_TRIANGLE = 0, RTC_GEOMETRY_TYPE_SPHERE_POINT = 50 };
enum RTCBufferType { RTC_BUFFER_TYPE_INDEX = 0, RTC_BUFFER_TYPE_VERTEX = 1 };
enum RTCFormat { RTC_FORMAT_UINT3 = 0x5003, RTC_FORMAT_FLOAT3 = 0x9003, RTC_FORMAT_FLOAT4 = 0x9004 };
enum RTCDeviceProperty { RTC_DEVICE_PROPERTY_VERSION = 0 };
enum RTCRayQueryFlags { RTC_RAY_QUERY_FLAG_COHERENT = 1 << 16 };

struct RTCIntersectArguments {
    RTCRayQueryFlags flags;
    int feature_mask;
    void* context;
    void* filter;
    void* intersect;
    float reserved[4];
};

inline void rtcInitIntersectArguments(RTCIntersectArguments* arguments)
{
    std::memset(arguments, 0, sizeof *arguments);
    arguments->feature_mask = -1;
}

struct alignas(16) RTCRay {
    float org_x, org_y, org_z, tnear;
    float dir_x, dir_y, dir_z, time;
    float tfar;
    unsigned mask, id, flags;
};

struct alignas(16) RTCHit {
    float Ng_x, Ng_y, Ng_z, u, v;
    unsigned primID, geomID, instID[1], instPrimID[1];
};

struct RTCRayHit {
    RTCRay ray;
    RTCHit hit;
};

template <int N> struct alignas(4 * N) RTCRayN {
    float org_x[N], org_y[N], org_z[N], tnear[N];
    float dir_x[N], dir_y[N], dir_z[N], time[N];
    float tfar[N];
    unsigned mask[N], id[N], flags[N];
};

template <int N> struct alignas(4 * N) RTCHitN {
    float Ng_x[N], Ng_y[N], Ng_z[N], u[N], v[N];
    unsigned primID[N], geomID[N], instID[1][N], instPrimID[1][N];
};

template <int N> struct RTCRayHitN {
    RTCRayN<N> ray;
    RTCHitN<N> hit;
};

using RTCRay8 = RTCRayN<8>;
using RTCRay16 = RTCRayN<16>;
using RTCRayHit8 = RTCRayHitN<8>;
using RTCRayHit16 = RTCRayHitN<16>;

extern "C" {
RTCDevice rtcNewDevice(const char* configuration);
void rtcReleaseDevice(RTCDevice);
ssize_t rtcGetDeviceProperty(RTCDevice, RTCDeviceProperty);
int rtcGetDeviceError(RTCDevice);
void rtcSetDeviceMemoryMonitorFunction(RTCDevice, bool (*)(void*, ssize_t bytes, bool is_done), void*);

RTCScene rtcNewScene(RTCDevice);
void rtcReleaseScene(RTCScene);
void rtcSetSceneFlags(RTCScene, RTCSceneFlags);
void rtcSetSceneBuildQuality(RTCScene, RTCBuildQuality);
void rtcCommitScene(RTCScene);

RTCGeometry rtcNewGeometry(RTCDevice, RTCGeometryType);
void rtcReleaseGeometry(RTCGeometry);
void rtcSetGeometryBuildQuality(RTCGeometry, RTCBuildQuality);
void rtcCommitGeometry(RTCGeometry);
unsigned rtcAttachGeometry(RTCScene, RTCGeometry);
void rtcSetSharedGeometryBuffer(
    RTCGeometry, RTCBufferType, unsigned slot, RTCFormat, const void*, size_t offset, size_t stride, size_t count);

void rtcIntersect1(RTCScene, RTCRayHit*, RTCIntersectArguments*);
void rtcIntersect8(const int* valid, RTCScene, RTCRayHit8*, RTCIntersectArguments*);
void rtcIntersect16(const int* valid, RTCScene, RTCRayHit16*, RTCIntersectArguments*);
void rtcOccluded1(RTCScene, RTCRay*, RTCIntersectArguments*);
void rtcOccluded8(const int* valid, RTCScene, RTCRay8*, RTCIntersectArguments*);
void rtcOccluded16(const int* valid, RTCScene, RTCRay16*, RTCIntersectArguments*);
}
