// Draws our frames with Embree: the peer that the experiments `embree` and `iso` measure ours against.
//
//     embree SCENE CONFIGURATION
//
// SCENE is a file of three 32-bit counts and that many vertices (3 floats), triangles (3 indices) and spheres
// (centre and radius); CONFIGURATION goes to Embree, besides `threads=1`. The program says its version in a line,
// and then obeys the lines it is sent, answering each with a line of JSON:
//
//     scene SCENE                         forgets all structures, and reads another scene
//     build STRUCTURE                     builds that structure anew
//     draw STRUCTURE PACKET FRAME         draws a picture; FRAME is the 22 numbers of `Frame`
//
// A STRUCTURE is two words: `fast` or `robust`, and how much care the builder takes: `low` (by Morton codes), `medium`
// or `high`. PACKET is `single`, `packet8` or `packet16`.
//
// Time is that of the whole process, so it holds whatever threads Embree might start. What is drawn, and in which
// order, is what `rt_core::render_tile` draws: see `bench/README.md`.
#include "embree_api.hpp"

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <fstream>
#include <iostream>
#include <limits>
#include <string>
#include <vector>
#ifdef __SSE__
#include <xmmintrin.h>
#endif

[[noreturn]] static void fail(const std::string& why)
{
    std::fprintf(stderr, "embree: %s\n", why.c_str());
    std::exit(1);
}

struct Vec3 {
    float x, y, z;
};

static inline Vec3 operator+(Vec3 a, Vec3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
static inline Vec3 operator-(Vec3 a, Vec3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
static inline Vec3 operator*(Vec3 a, float s) { return {a.x * s, a.y * s, a.z * s}; }
static inline float dot(Vec3 a, Vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// One picture to draw, in the order in which its numbers are sent. Width and height are multiples of TILE.
// The ray of pixel (x, y) goes along forward + up * (y_first + y * y_step) + right * (x_first + x * x_step).
struct Frame {
    int width, height;
    Vec3 eye, forward, right, up;
    float x_first, x_step, y_first, y_step;
    Vec3 light;
    float shadow_offset;
};

// What the rays of a picture met.
struct Counts {
    uint64_t primary = 0, hits = 0, shadow = 0, lit = 0;
};

static const int TILE = 16;
static const float BACKGROUND = 0.2f, AMBIENT = 0.1f, DIFFUSE = 0.9f, ALBEDO = 0.8f;

// ------------------------------------------------------------------------------------------------ drawing

// N rays that are asked for at once, of a block of neighbouring pixels.
template <int N> struct Packet;
template <> struct Packet<1> {
    using Ray = RTCRay;
    using RayHit = RTCRayHit;
    static const int columns = 1, rows = 1;
};
template <> struct Packet<8> {
    using Ray = RTCRay8;
    using RayHit = RTCRayHit8;
    static const int columns = 4, rows = 2;
};
template <> struct Packet<16> {
    using Ray = RTCRay16;
    using RayHit = RTCRayHit16;
    static const int columns = 4, rows = 4;
};

// Lane `k` of a member of a packet; a single ray's members have one lane.
template <typename T, size_t N> static inline T& lane(T (&of)[N], int k) { return of[k]; }
template <typename T> static inline T& lane(T& of, int) { return of; }

template <typename Ray> static inline Vec3 direction(Ray& ray, int k)
{
    return {lane(ray.dir_x, k), lane(ray.dir_y, k), lane(ray.dir_z, k)};
}

template <typename Ray> static inline void set(Ray& ray, int k, Vec3 origin, Vec3 direction, float t_max)
{
    lane(ray.org_x, k) = origin.x, lane(ray.org_y, k) = origin.y, lane(ray.org_z, k) = origin.z;
    lane(ray.dir_x, k) = direction.x, lane(ray.dir_y, k) = direction.y, lane(ray.dir_z, k) = direction.z;
    lane(ray.tnear, k) = 0.0f, lane(ray.tfar, k) = t_max;
}

// A block of pixels on its way from rays to greys. Every loop over lanes is one that the compiler can vectorise.
template <int N> class Block {
public:
    Block(RTCScene scene, const Frame& frame) : scene(scene), frame(frame)
    {
        std::memset(&rays, 0, sizeof rays);
        std::memset(&shadows, 0, sizeof shadows);
        for (int k = 0; k < N; k++) lane(rays.ray.mask, k) = lane(shadows.mask, k) = ~0u;
        for (int k = 0; k < N; k++) all[k] = -1;
    }

    // Draws the block whose upper left pixel is (x, y).
    void draw(int x, int y, uint8_t* picture, Counts& counts)
    {
        aim(x, y);
        nearest(all, scene, query, rays);
        int hits = 0, facing = 0;
        for (int k = 0; k < N; k++) hits += is_hit(k);
        counts.primary += N;
        counts.hits += hits;
        if (hits) facing = face_light();
        if (facing) {
            blocked(is_facing, scene, query, shadows);
            counts.shadow += facing;
            counts.lit += light_up();
        }
        store(x, y, picture);
    }

private:
    static const int columns = Packet<N>::columns, rows = Packet<N>::rows;

    RTCScene scene;
    // A copy: what is stored through pointers cannot be part of it, which vectorising needs to know.
    Frame frame;
    Query query;
    alignas(64) typename Packet<N>::RayHit rays;
    alignas(64) typename Packet<N>::Ray shadows;
    alignas(64) int all[N];
    // -1 for lanes with a shadow ray, else 0, as Embree wants it.
    alignas(64) int is_facing[N];
    // Cosine between normal and light; 0 for lanes that no light reaches.
    alignas(64) float cosine[N];

    bool is_hit(int k) { return lane(rays.hit.geomID, k) != RTC_INVALID_GEOMETRY_ID; }

    void aim(int x, int y)
    {
        for (int k = 0; k < N; k++) {
            Vec3 row = frame.forward + frame.up * (frame.y_first + float(y + k / columns) * frame.y_step);
            Vec3 along = row + frame.right * (frame.x_first + float(x + k % columns) * frame.x_step);
            set(rays.ray, k, frame.eye, along, std::numeric_limits<float>::infinity());
            lane(rays.hit.geomID, k) = RTC_INVALID_GEOMETRY_ID;
            cosine[k] = 0.0f;
        }
    }

    // Makes the shadow rays of the points that face the light. Returns how many do.
    int face_light()
    {
        int count = 0;
        for (int k = 0; k < N; k++) {
            Vec3 along = direction(rays.ray, k);
            Vec3 normal = {lane(rays.hit.Ng_x, k), lane(rays.hit.Ng_y, k), lane(rays.hit.Ng_z, k)};
            float scale = 1.0f / std::sqrt(dot(normal, normal));
            normal = normal * (dot(normal, along) > 0.0f ? -scale : scale);
            Vec3 point = frame.eye + along * lane(rays.ray.tfar, k) + normal * frame.shadow_offset;
            Vec3 to_light = frame.light - point;
            float facing = dot(normal, to_light);
            bool is_one = is_hit(k) & (facing > 0.0f);
            // Embree 3 wants lanes without a ray to hold one that could be.
            set(shadows, k, is_one ? point : frame.eye, is_one ? to_light : frame.forward, 1.0f);
            is_facing[k] = is_one ? -1 : 0;
            cosine[k] = is_one ? facing / std::sqrt(dot(to_light, to_light)) : 0.0f;
            count += is_one;
        }
        return count;
    }

    // Embree makes `tfar` negative where a ray is blocked. Returns how many points the light reaches.
    int light_up()
    {
        int count = 0;
        for (int k = 0; k < N; k++) {
            bool is_lit = (is_facing[k] != 0) & (lane(shadows.tfar, k) >= 0.0f);
            cosine[k] = is_lit ? cosine[k] : 0.0f;
            count += is_lit;
        }
        return count;
    }

    void store(int x, int y, uint8_t* picture)
    {
        uint8_t greys[N];
        for (int k = 0; k < N; k++) {
            float grey = is_hit(k) ? ALBEDO * (AMBIENT + DIFFUSE * cosine[k]) : BACKGROUND;
            greys[k] = uint8_t(int(grey * 255.0f + 0.5f));
        }
        for (int row = 0; row < rows; row++)
            std::memcpy(picture + size_t(y + row) * frame.width + x, greys + row * columns, columns);
    }
};

// Draws a picture tile by tile, and each tile block by block.
template <int N> static Counts draw(RTCScene scene, const Frame& frame, uint8_t* picture)
{
    Block<N> block(scene, frame);
    Counts counts;
    for (int tile_y = 0; tile_y < frame.height; tile_y += TILE)
        for (int tile_x = 0; tile_x < frame.width; tile_x += TILE)
            for (int y = tile_y; y < tile_y + TILE; y += Packet<N>::rows)
                for (int x = tile_x; x < tile_x + TILE; x += Packet<N>::columns)
                    block.draw(x, y, picture, counts);
    return counts;
}

// ------------------------------------------------------------------------------------------------ the scene

// What the structures are built over; Embree reads vertices and indices in place.
struct Scene {
    uint32_t vertex_count, triangle_count, sphere_count;
    std::vector<float> vertices, spheres;
    std::vector<uint32_t> triangles;
};

template <typename T> static void read(std::ifstream& file, std::vector<T>& into, size_t count)
{
    // Embree may read 16 bytes where the last vertex begins.
    into.resize(count + 4);
    file.read(reinterpret_cast<char*>(into.data()), std::streamsize(count * sizeof(T)));
}

static Scene read_scene(const char* path)
{
    std::ifstream file(path, std::ios::binary);
    uint32_t counts[3] = {0, 0, 0};
    file.read(reinterpret_cast<char*>(counts), sizeof counts);
    Scene scene = {counts[0], counts[1], counts[2], {}, {}, {}};
    read(file, scene.vertices, size_t(3) * scene.vertex_count);
    read(file, scene.triangles, size_t(3) * scene.triangle_count);
    read(file, scene.spheres, size_t(4) * scene.sphere_count);
    if (!file) fail(std::string("cannot read the scene ") + path);
    return scene;
}

// Bytes that Embree holds, as it reports them.
static ssize_t embree_bytes = 0;

static bool count_bytes(void*, ssize_t bytes, bool)
{
    embree_bytes += bytes;
    return true;
}

static void attach(RTCScene to, RTCGeometry geometry)
{
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(to, geometry);
    rtcReleaseGeometry(geometry);
}

enum Quality { LOW, MEDIUM, HIGH, QUALITIES };

static const char* const QUALITY_NAMES[QUALITIES] = {"low", "medium", "high"};
static const RTCBuildQuality EMBREE_QUALITIES[QUALITIES]
    = {RTC_BUILD_QUALITY_LOW, RTC_BUILD_QUALITY_MEDIUM, RTC_BUILD_QUALITY_HIGH};

static RTCScene build(RTCDevice device, const Scene& scene, bool is_robust, Quality quality)
{
    RTCScene built = rtcNewScene(device);
    // Embree builds by Morton codes only where scene and geometry both ask for it.
    int flags = (is_robust ? RTC_SCENE_FLAG_ROBUST : 0) | (quality == LOW ? RTC_SCENE_FLAG_DYNAMIC : 0);
    rtcSetSceneFlags(built, RTCSceneFlags(flags));
    rtcSetSceneBuildQuality(built, EMBREE_QUALITIES[quality]);
    if (scene.triangle_count) {
        RTCGeometry mesh = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
        rtcSetSharedGeometryBuffer(mesh, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, scene.vertices.data(), 0,
            3 * sizeof(float), scene.vertex_count);
        rtcSetSharedGeometryBuffer(mesh, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, scene.triangles.data(), 0,
            3 * sizeof(uint32_t), scene.triangle_count);
        if (quality == LOW) rtcSetGeometryBuildQuality(mesh, RTC_BUILD_QUALITY_LOW);
        attach(built, mesh);
    }
    if (scene.sphere_count) {
        RTCGeometry spheres = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_SPHERE_POINT);
        rtcSetSharedGeometryBuffer(spheres, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT4, scene.spheres.data(), 0,
            4 * sizeof(float), scene.sphere_count);
        attach(built, spheres);
    }
    rtcCommitScene(built);
    return built;
}

// ------------------------------------------------------------------------------------------------ commands

static double seconds(clockid_t clock)
{
    timespec time;
    clock_gettime(clock, &time);
    return double(time.tv_sec) + 1e-9 * double(time.tv_nsec);
}

struct Stopwatch {
    double cpu = seconds(CLOCK_PROCESS_CPUTIME_ID), wall = seconds(CLOCK_MONOTONIC);

    double cpu_ms() const { return 1e3 * (seconds(CLOCK_PROCESS_CPUTIME_ID) - cpu); }
    double wall_ms() const { return 1e3 * (seconds(CLOCK_MONOTONIC) - wall); }
};

static std::string word()
{
    std::string word;
    if (!(std::cin >> word)) fail("the line ends too early");
    return word;
}

// One of two words: is it the second?
static bool is_second(const char* first, const char* second)
{
    std::string got = word();
    if (got != first && got != second) fail("expected " + std::string(first) + " or " + second + ", got " + got);
    return got == second;
}

// A number, which may be NaN: where there is no light.
static float number() { return std::strtof(word().c_str(), nullptr); }

static Vec3 vector()
{
    float x = number(), y = number(), z = number();
    return {x, y, z};
}

static Frame read_frame()
{
    Frame frame;
    frame.width = std::atoi(word().c_str());
    frame.height = std::atoi(word().c_str());
    frame.eye = vector();
    frame.forward = vector();
    frame.right = vector();
    frame.up = vector();
    for (float* of : {&frame.x_first, &frame.x_step, &frame.y_first, &frame.y_step}) *of = number();
    frame.light = vector();
    frame.shadow_offset = number();
    if (frame.width <= 0 || frame.height <= 0 || frame.width % TILE || frame.height % TILE)
        fail("width and height must be multiples of the tile");
    return frame;
}

// The structures: fast, robust; each by its quality.
static RTCScene structures[2][QUALITIES] = {};

static void forget_structures()
{
    for (auto& of_edges : structures)
        for (RTCScene& structure : of_edges)
            if (structure) rtcReleaseScene(structure), structure = nullptr;
}

static Quality read_quality()
{
    std::string got = word();
    for (int quality = 0; quality < QUALITIES; quality++)
        if (got == QUALITY_NAMES[quality]) return Quality(quality);
    fail("there is no quality " + got);
}

static void obey_scene(Scene& scene)
{
    forget_structures();
    scene = read_scene(word().c_str());
    std::printf("{\"triangles\":%u}\n", scene.triangle_count);
}

static void obey_build(RTCDevice device, const Scene& scene)
{
    bool is_robust = is_second("fast", "robust");
    Quality quality = read_quality();
    RTCScene& structure = structures[is_robust][quality];
    if (structure) rtcReleaseScene(structure);
    ssize_t bytes_before = embree_bytes;
    Stopwatch watch;
    structure = build(device, scene, is_robust, quality);
    double cpu_ms = watch.cpu_ms(), wall_ms = watch.wall_ms();
    if (int error = rtcGetDeviceError(device)) fail("cannot build: error " + std::to_string(error));
    std::printf("{\"cpu_ms\":%.6f,\"wall_ms\":%.6f,\"bytes\":%zd}\n", cpu_ms, wall_ms, embree_bytes - bytes_before);
}

static void obey_draw()
{
    bool is_robust = is_second("fast", "robust");
    RTCScene structure = structures[is_robust][read_quality()];
    std::string mode = word();
    Frame frame = read_frame();
    if (!structure) fail("nothing was built to draw");
    auto draw_mode = mode == "single" ? draw<1> : mode == "packet8" ? draw<8> : mode == "packet16" ? draw<16> : nullptr;
    if (!draw_mode) fail("there is no mode " + mode);
    static std::vector<uint8_t> picture;
    picture.resize(size_t(frame.width) * frame.height);

    Stopwatch watch;
    Counts counts = draw_mode(structure, frame, picture.data());
    double cpu_ms = watch.cpu_ms(), wall_ms = watch.wall_ms();

    unsigned long long greys = 0;
    for (uint8_t grey : picture) greys += grey;
    std::printf("{\"cpu_ms\":%.6f,\"wall_ms\":%.6f,\"primary\":%llu,\"hits\":%llu,\"shadow\":%llu,\"lit\":%llu,"
                "\"greys\":%llu}\n",
        cpu_ms, wall_ms, (unsigned long long)counts.primary, (unsigned long long)counts.hits,
        (unsigned long long)counts.shadow, (unsigned long long)counts.lit, greys);
}

int main(int count, char** arguments)
{
    if (count != 3) fail("usage: embree SCENE CONFIGURATION");
#ifdef __SSE__
    // Embree's manual asks for it: denormals are slow. Flush to zero, and denormals are zero.
    _mm_setcsr(_mm_getcsr() | 0x8040);
#endif
    Scene scene = read_scene(arguments[1]);
    RTCDevice device = rtcNewDevice((std::string("threads=1,") + arguments[2]).c_str());
    if (!device) fail("Embree refuses to start");
    rtcSetDeviceMemoryMonitorFunction(device, count_bytes, nullptr);
    std::printf("{\"version\":%d}\n", int(rtcGetDeviceProperty(device, RTC_DEVICE_PROPERTY_VERSION)));
    std::fflush(stdout);
    for (std::string command; std::cin >> command; std::fflush(stdout)) {
        if (command == "scene") obey_scene(scene);
        else if (command == "build") obey_build(device, scene);
        else if (command == "draw") obey_draw();
        else fail("there is no command " + command);
    }
    forget_structures();
    rtcReleaseDevice(device);
}
